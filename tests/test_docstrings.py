"""What is exported is documented as numpydoc asks, and examples in docstrings run."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import sdp_vs_penalty

ROOT = Path(sdp_vs_penalty.__file__).parent
#: Modules, and packages by their own name.
WITH_EXAMPLES = [
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )
    for path in sorted(ROOT.rglob("*.py"))
    if ">>> " in path.read_text()
]
#: Their examples go from simulated runs to a model, and to what it misses.
WHOLE_WAYS = (
    "sdp_vs_penalty.api.diagnosis",
    "sdp_vs_penalty.api.identification",
    "sdp_vs_penalty.ranges.table",
)
#: Of numpydoc's checks: a docstring (GL08), every argument and no other, in order (PR01,
#: PR02, PR03), a type and a description of each (PR04, PR07), what is returned (RT01).
CHECKS = {"GL08", "PR01", "PR02", "PR03", "PR04", "PR07", "RT01"}
PUBLIC = [
    name
    for name in sdp_vs_penalty.__all__
    if inspect.isroutine(getattr(sdp_vs_penalty, name))
    or inspect.isclass(getattr(sdp_vs_penalty, name))
]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=pytest.mark.long if x in WHOLE_WAYS else ())
        for x in WITH_EXAMPLES
    ],
)
def test_examples_run(name):
    if name.startswith("sdp_vs_penalty.page"):
        pytest.importorskip("nicegui", reason="the page needs the extra [page]")
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


def numpydoc_errors(name):
    """What numpydoc misses in the docstring of a public name."""
    numpydoc = pytest.importorskip("numpydoc.validate")
    public = getattr(sdp_vs_penalty, name)
    result = numpydoc.validate(f"{public.__module__}.{name}")
    return [f"{code}: {text}" for code, text in result["errors"] if code in CHECKS]


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_is_documented_in_sections(name):
    assert not numpydoc_errors(name)


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_function_says_where_it_raises(name):
    public = getattr(sdp_vs_penalty, name)
    if inspect.isroutine(public):
        assert "InputError" in str(inspect.getdoc(public))
