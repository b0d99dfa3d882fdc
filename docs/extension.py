"""What Sphinx needs beyond its settings: generated text in pages, equations as MathML, fields of records in the reference."""

from typing import Any

import generated
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("source-read", _expand)
    app.connect("env-get-outdated", lambda *_: sorted(generated.pages()))
    app.connect("autodoc-process-docstring", _fields)
    app.connect("autodoc-process-signature", _signature)
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True}


def _expand(app: Sphinx, page: str, source: list[str]) -> None:
    source[0] = generated.expand(source[0])


# --- equations: every browser draws MathML by itself, so that pages read from disk need nothing else ---------------------


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="equation">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


# --- reference ----------------------------------------------------------------------------------------------------------


def _fields(app: Sphinx, what: str, name: str, held: Any, options: Any, lines: list[str]) -> None:
    """The fields of a class of data, below its docstring."""
    if what == "class":
        lines += generated.field_list(held)


def _signature(app: Sphinx, what: str, name: str, held: Any, options: Any, given: str, returns: str) -> Any:
    """None for a class of data: its fields say the same, with their units."""
    return ("", returns) if what == "class" and generated.field_list(held) else None
