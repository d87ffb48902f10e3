// A click on a picture of the page (or Enter) shows it as large as the window; arrows go on, Escape or a click closes.
function enlargeable() {
  const dialog = document.createElement('dialog'), shown = new Image(), words = document.createElement('p');
  const pictures = [...document.querySelectorAll('main figure > img')];
  let at = 0;
  dialog.className = 'enlarged';
  dialog.append(shown, words);
  document.body.append(dialog);
  const show = k => {
    at = (k + pictures.length) % pictures.length;
    shown.src = pictures[at].src;
    shown.alt = pictures[at].alt;
    const grown = Math.min(0.96 * innerWidth / pictures[at].naturalWidth, 0.88 * innerHeight / pictures[at].naturalHeight);
    shown.width = Math.round(pictures[at].naturalWidth * grown);
    const card = pictures[at].closest('.card')?.querySelector('h3');
    words.textContent = [card?.textContent, pictures[at].alt, `${pictures[at].naturalWidth} × ${pictures[at].naturalHeight} px`].filter(Boolean).join(' · ');
  };
  pictures.forEach((picture, k) => {
    const open = () => { show(k); dialog.showModal(); };
    picture.tabIndex = 0;
    picture.setAttribute('role', 'button');
    picture.classList.add('opens');
    picture.addEventListener('click', open);
    picture.addEventListener('keydown', event => { if (event.key === 'Enter' || event.key === ' ') { event.preventDefault(); open(); } });
  });
  dialog.addEventListener('click', () => dialog.close());
  dialog.addEventListener('keydown', event => {
    if (event.key === 'ArrowRight' || event.key === 'ArrowLeft') { event.preventDefault(); show(at + (event.key === 'ArrowRight' ? 1 : -1)); }
  });
}
