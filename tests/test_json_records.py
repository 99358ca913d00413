"""Records come back from JSON as they went, and others are refused."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest
from drawn import given, st
from numpy.typing import NDArray

from sdp_vs_penalty.files import JsonRecord

finite = st.floats(-1e6, 1e6)


@dataclass(frozen=True)
class Inner(JsonRecord):
    size: float
    kind: Literal["a", "b"] = "a"


@dataclass(frozen=True)
class Outer(JsonRecord):
    name: str
    few: tuple[int, str]
    many: tuple[Inner, ...]
    rows: NDArray[np.float64]
    by_name: Mapping[str, float]
    far: float = np.inf
    more: Inner | None = None


@given(
    st.lists(finite, max_size=3),
    st.sampled_from(["a", "b"]),
    st.text(max_size=5),
    finite,
)
def test_records_come_back(sizes, kind, name, far):
    inner = tuple(Inner(size, kind) for size in sizes)
    record = Outer(
        name=name,
        few=(3, "x"),
        many=inner,
        rows=np.array([sizes, sizes]),
        by_name={"k": far},
        far=far,
        more=next(iter(inner), None),
    )
    text = json.dumps(record.to_dict())
    back = Outer.from_dict(json.loads(text))
    assert back.to_dict() == record.to_dict()
    assert back.few == record.few
    assert back.many == record.many
    assert back.more == record.more
    assert back.far == record.far
    np.testing.assert_array_equal(back.rows, record.rows)


SOUND: dict[str, Any] = {
    "name": "n",
    "few": [1, "x"],
    "many": [],
    "rows": [1.0],
    "by_name": {},
}


def test_none_is_infinity_where_a_number_may_be_infinite():
    assert Outer.from_dict(SOUND | {"far": None, "more": None}).far == np.inf


def test_infinity_is_none_in_json():
    record = Outer("n", (1, "x"), (), np.ones(1), {})
    assert record.to_dict()["far"] is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("name", 3),
        ("name", None),
        ("few", [1]),
        ("few", "ab"),
        ("many", "x"),
        ("many", [{"kind": "a"}]),
        ("many", [{"size": 1.0, "kind": "c"}]),
        ("rows", "x"),
        ("by_name", 3),
        ("more", 3),
    ],
)
def test_a_field_of_another_kind_is_refused(key, value):
    with pytest.raises((KeyError, TypeError, ValueError, AttributeError)):
        Outer.from_dict(SOUND | {key: value})


def test_a_missing_field_is_named():
    without = dict(SOUND)
    del without["few"]
    with pytest.raises(KeyError, match="few"):
        Outer.from_dict(without)
