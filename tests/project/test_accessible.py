"""Pages of the site are read by keys and by screen readers."""

from docs.extensions.accessible import _mend


def mended(body: str) -> str:
    context = {"body": body}
    _mend(None, "page", "page.html", context, None)  # pyright: ignore[reportArgumentType]
    return context["body"]


def test_wide_blocks_and_tables_are_scrolled_by_keys():
    assert mended("<pre>x</pre>") == '<pre tabindex="0">x</pre>'
    assert mended('<div class="table-wrapper docutils">') == '<div tabindex="0" class="table-wrapper docutils">'


def test_parameters_of_a_signature_are_no_list_without_terms():
    signature = "f(\n<dl>\n<dd>a,</dd>\n<dd>b,</dd>\n</dl>\n)"
    lines = '<span class="parameter">a,</span>\n<span class="parameter">b,</span>\n'
    assert mended(signature) == f'f(\n<span class="parameters">{lines}</span>\n)'
    terms = "<dl>\n<dt>term</dt><dd>meaning</dd>\n</dl>"
    assert mended(terms) == terms
