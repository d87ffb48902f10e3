"""A page in headless Chromium that sends arrays back: served from this process alone, drawn by the software renderer."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import threading
from collections.abc import Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
OPTIONS = (
    "--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync", "--disable-quic",
    "--disable-component-update", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
PATIENCE_S = 900.0
TYPES = {".js": "text/javascript", ".html": "text/html; charset=utf-8"}
SEND = """<script>
const send = (name, data) => fetch('/sent/' + name, {method: 'POST', body: data});
window.addEventListener('error', e => send('fault', e.message));
window.addEventListener('unhandledrejection', e => send('fault', String(e.reason && e.reason.stack || e.reason)));
</script>"""
"""What a page begins with: send(name, a typed array) hands an array over; what goes wrong ends the wait."""


def arrays_from(page: str, served: Mapping[str, Path | bytes], names: Sequence[str]) -> dict[str, NDArray[np.float32]]:
    """float32 values by name, as the page sends them.

    Args:
        page: HTML, with `SEND` in it.
        served: what it may ask for, by path; a folder stands for all below it.
        names: what it will send.

    Returns:
        Flat arrays by name.

    Raises:
        RuntimeError: no browser, an error in the page, or nothing within `PATIENCE_S`.
    """
    if CHROMIUM is None:
        raise RuntimeError("no Chromium to draw with")
    sent: dict[str, bytes] = {}
    done = threading.Event()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler({**served, "/page.html": page.encode()}, sent, set(names), done))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as profile:
        url = f"http://127.0.0.1:{server.server_port}/page.html"
        command = [CHROMIUM, *OPTIONS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            done.wait(PATIENCE_S)
        finally:
            browser.terminate()
            browser.wait()
            server.shutdown()
    missing = [name for name in names if name not in sent]
    if missing:
        raise RuntimeError(sent.get("fault", b"the page sent nothing").decode() + f" (missing: {', '.join(missing)})")
    return {name: np.frombuffer(sent[name], np.float32) for name in names}


def _handler(
    served: Mapping[str, Path | bytes], sent: dict[str, bytes], wanted: set[str], done: threading.Event
) -> type[BaseHTTPRequestHandler]:
    """Answers of the page's own server."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = _found(served, self.path.partition("?")[0])
            self.send_response(404 if found is None else 200)
            self.send_header("Content-Type", TYPES.get(Path(self.path).suffix, "application/octet-stream"))
            self.end_headers()
            self.wfile.write(found or b"")

        def do_POST(self) -> None:
            sent[self.path.rpartition("/")[2]] = self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(204)
            self.end_headers()
            if wanted <= set(sent) or "fault" in sent:
                done.set()

        def log_message(self, format: str, *args: object) -> None:
            pass

    return Handler


def _found(served: Mapping[str, Path | bytes], path: str) -> bytes | None:
    for name, what in served.items():
        if isinstance(what, bytes):
            if path == name:
                return what
        elif path == name or path.startswith(name + "/"):
            file = what / path[len(name) :].lstrip("/") if path != name else what
            return file.read_bytes() if file.is_file() else None
    return None
