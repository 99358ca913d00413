"""The record of a remedy: what is not in its table cannot be advised."""

import pytest

from sdp_vs_penalty import InputError
from sdp_vs_penalty.results import Change, Remedy


@pytest.mark.parametrize(
    ("verb", "arguments"), [("repaint", {}), ("hold", {"gravity": [0.0, 0.0, -9.81]})]
)
def test_a_change_outside_the_table_is_refused(verb, arguments):
    with pytest.raises(InputError, match=r"choose one of|name one of"):
        Change(verb, "do it", arguments)


def test_a_remedy_comes_back_from_its_json():
    change = Change("mount", "set gravity", {"gravity": [0.0, -9.81, 0.0]})
    remedy = Remedy("it hangs on a wall", "likely", "by the torques", change, (1.0,))
    assert Remedy.from_dict(remedy.to_dict()) == remedy
