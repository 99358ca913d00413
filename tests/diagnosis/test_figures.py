"""No figure of small logs changes unnoticed: a change that is meant is written anew, and told.

``SDP_VS_PENALTY_FIGURES=write pytest tests/diagnosis/test_figures.py`` writes tests/data/figures/*.json.
"""

import json
import os
from pathlib import Path

import pytest
from figures import CASES, brief, differences

HOME = Path(__file__).parents[1] / "data" / "figures"


@pytest.mark.parametrize("name", CASES)
def test_figures_are_what_they_were(name, tmp_path):
    found, path = brief(CASES[name](tmp_path)), HOME / f"{name}.json"
    if os.environ.get("SDP_VS_PENALTY_FIGURES") == "write":
        lines = (f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.items())
        path.parent.mkdir(exist_ok=True)
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    assert not differences(json.loads(path.read_text()), json.loads(json.dumps(found)))[:20]
