"""Contracts that every effect of the library keeps; a new file is asked the same
without a word here."""

import effect_contract
import numpy as np
import pytest

from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.effects.effect import SimulatorTerm
from sdp_vs_penalty.simulation import MAKERS
from sdp_vs_penalty.testing import effect_contract as contracts
from sdp_vs_penalty.testing.demand import ContractError

#: An effect whose memory is long: its torque takes seconds to make.
DEAR = ("joint_resonance",)


def tables(robot):
    """Measured, not searched: the table over what is more than a joint's own signal."""
    kind = effect_types()["measured_curve"]
    kinds = [j.kind for j in robot.joints]
    other = 2 + kinds[1:].index(kinds[0]) if kinds[0] in kinds[1:] else 0
    over = [f"x={w}@xj=1@xi={other}@xc=-2" for w in ("q", "dq") if other]
    ends = "@xlow=-0.4@xhigh=0.9@v1=-1@v2=2"
    texts = [f"measured_curve:1@{x}{ends}" for x in over]
    return [kind(robot), *parse_effects(texts, robot)]


def forms_of(name, contract):
    """The forms that a contract is asked of."""
    if name == "measured_curve":
        return tables

    def forms(robot):
        found = contracts.variants(effect_types()[name], robot)
        if contract is not contracts.check_memory:
            return found
        # Smoothed both ways, over whole runs.
        both = [e for e in found if e.shape.get("phase") == 2.0 or "band" in e.shape]
        assert all(e.has_memory for e in both)
        return [e for e in found if e not in both]

    return forms


@pytest.mark.parametrize("name", effect_types())
def test_every_effect_keeps_every_contract(name):
    for contract in contracts.CONTRACTS:
        contract(effect_types()[name], forms_of(name, contract))


class _Wrong(effect_types()["joint_spring"]):
    """A spring with something wrong in each subclass."""

    name = "joint_spring"


WRONG = {
    "check_units": {"units": ("N*m", "N")},
    "check_needs_are_declared": {"needs_links": True},
    "check_once_or_several": {"several": True},
    "check_frozen_only": {"frozen_only": True},
    "check_columns_fit_any_robot": {"symbol": "", "parameter_name": lambda *_: "k"},
    "check_memory": {"column": lambda self, motion, j: motion.q[::-1, j]},
    "check_every_parameter_makes_torque": {
        "column": lambda self, m, j: 0.0 * m.q[:, j]
    },
    "check_constraints": {"constraints": lambda self, *_: []},
    "check_written_form": {"text": "coulomb_friction"},
    "check_simulator_fields": {
        "simulator_terms": lambda self, theta: [
            SimulatorTerm("stiffness", 0, x) for x in theta if x
        ]
    },
    "check_hidden_torque": {
        "hidden_torque": staticmethod(
            lambda motion, joint, sign: motion.q[:, joint] ** 2
        )
    },
}


@pytest.mark.parametrize("name", WRONG)
def test_a_contract_that_is_broken_is_said(name):
    kind = type("_Spring", (_Wrong,), WRONG[name])
    with pytest.raises(ContractError):
        getattr(contracts, name)(kind, lambda robot: [kind(robot)])


def test_a_second_statement_shares_nothing_with_the_columns():
    kind = effect_types()["joint_spring"]
    same = staticmethod(lambda motion, joint, sign: kind.column(None, motion, joint))
    copied = type("_Spring", (_Wrong,), {"hidden_torque": same})
    with pytest.raises(ContractError, match="hidden_torque uses kind"):
        contracts.check_hidden_torque(copied, lambda robot: [copied(robot)])


def test_a_second_statement_is_zero_where_its_columns_are():
    far = {
        "column": lambda self, m, j: np.maximum(m.q[:, j] - 1e3, 0.0),
        "hidden_torque": lambda m, j, sign: np.maximum(m.q[:, j] - 1e3, 0.0),
    }
    unreached = type("_Stop", (_Wrong,), far)
    contracts.check_hidden_torque(unreached, lambda robot: [unreached(robot)])
    # Of two parameters a joint, the statement may be any sum, but not nothing.
    nothing = {"hidden_torque": lambda m, j, sign, **shape: 0.0 * m.q[:, j]}
    kind = effect_types()["torque_ripple"]
    silent = type("_Ripple", (kind,), {"name": "torque_ripple", **nothing})
    with pytest.raises(ContractError, match="is not the torque of torque_ripple"):
        contracts.check_hidden_torque(silent, lambda robot: [silent(robot)])


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=pytest.mark.long if x in DEAR else ()) for x in MAKERS],
)
def test_columns_are_the_hidden_torque(name):
    effect_contract.check_columns_are_the_hidden_torque(name)
