"""Pages from templates: one file each, styled, without links."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent


def render(template: str, context: Mapping[str, Any], folder: Path = FOLDER) -> str:
    """Fill a template; everything is escaped unless the template says otherwise.

    Args:
        template: file name in `folder`, or in this one, whose macros and `style` are at hand in every template.
        context: what the template names; a name that is missing raises.
        folder: where to look first.

    Returns:
        The page.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, FOLDER]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.globals.update(style=(FOLDER / "style.css").read_text())
    return environment.get_template(template).render(**context)
