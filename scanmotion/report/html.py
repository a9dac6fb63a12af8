"""What pages are built of: page, table, picture, section; nothing is loaded from anywhere."""

import base64
import io
import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 1180px;
margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.6em; margin-bottom: .2em }
h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; margin: .6em 0 } td, th { padding: .15em .8em .15em 0; text-align: left;
vertical-align: top; border-bottom: 1px solid #eee } th { font-weight: 600; color: #555 }
img { max-width: 100% } pre { background: #f6f6f6; padding: .8em; overflow-x: auto; font-size: 12px }
.ok { color: #1d7a50 } .bad { color: #c8102e } .note { color: #666 } td.n { text-align: right }
td.n, td.w { white-space: nowrap; font-variant-numeric: tabular-nums } details { margin: .6em 0 }
.wide { overflow-x: auto } .first { font-size: 1.25em; line-height: 1.35; max-width: 44em }
table.sheet { width: 100%; max-width: 44em } table.sheet th { width: 13em }
table.sheet td { border-bottom: 1px solid #999; height: 1.7em }
@media (max-width: 600px) { body { margin: .8em auto; padding: 0 .7em } p { overflow-wrap: anywhere }
table { font-size: 13px } td, th { padding-right: .5em } table.sheet th { width: 8em } }
@media print { @page { size: A4; margin: 14mm } body { font-size: 10pt;
max-width: none; margin: 0; padding: 0 }
h1 { margin-top: 0 } h2 { break-after: avoid; margin-top: 1em } img { max-height: 225mm; break-inside: avoid }
tr { break-inside: avoid } table { font-size: 9pt } .wide { overflow: visible }
.appendix { break-before: page } .appendix img { max-height: 110mm } }
"""
_POSITION = re.compile(r"([-+]?[0-9.]+ *){3}")
# The page may load nothing at all: neither script nor picture nor font from anywhere.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def page(title: str, body: str) -> str:
    """A whole HTML page in the house's style that may load nothing from anywhere.

    Args:
        title: plain text.
        body: HTML.
    """
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def table(header: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> str:
    """An HTML table; every cell is escaped, numbers under a header stand to the right."""

    def cell(value: object) -> str:
        text = str(value)
        number = header and re.fullmatch(r"[-+]?[0-9.]+%?", text)
        kind = ' class="n"' if number else ' class="w"' if _POSITION.fullmatch(text) else ""
        return f"<td{kind}>{escape(text)}</td>"

    head = "".join(f"<th>{escape(h)}</th>" for h in header)
    lines = "\n".join("<tr>" + "".join(map(cell, row)) + "</tr>" for row in rows)
    return f'<div class="wide"><table>{f"<tr>{head}</tr>" if header else ""}\n{lines}</table></div>'


def image(figure: "Figure", what: str) -> str:
    """A figure as an inline picture."""
    buffer = io.BytesIO()
    # Without metadata: the same plan gives the same bytes.
    figure.savefig(buffer, format="png", metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<p><img alt="{escape(what)}" src="data:image/png;base64,{data}"></p>'


def section(title: str, *parts: str) -> str:
    """A heading and what stands below it."""
    return f"<h2>{escape(title)}</h2>\n" + "\n".join(parts)
