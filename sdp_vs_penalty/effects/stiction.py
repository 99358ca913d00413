"""Coulomb friction that holds a joint at rest."""

from sdp_vs_penalty.effects.presliding_hysteresis import PreslidingHysteresis
from sdp_vs_penalty.effects.shape import POSITION, Shape


class Stiction(PreslidingHysteresis):
    name = "stiction"
    equation = "f_s (z - sign(dq)), z the last way of sliding"
    explanation = (
        "Dry friction holds a joint at rest, where a smooth sign of the velocity lets go: what it held "
        "at last it goes on holding until the joint slides the other way. Pushed, it is anything up to "
        "its Coulomb level, which no motion tells. The positions stay alike meanwhile: over what travel "
        "it turns round (presliding) cannot be told."
    )
    reference = "Karnopp, ASME J. Dyn. Sys. Meas. Control 1985; Stewart, SIAM Review 2000"
    symbol = "f_s"
    refines: tuple[str, ...] = ("coulomb_friction",)
    at_rest = "holds"
    #: Short travels, over which the computed state forgets what the filter makes of a joint at rest.
    shapes = {
        "d": Shape(0.0001, POSITION, grid=(0.00001, 0.00003, 0.0001, 0.0003), bounds=(0.00001, 0.001))
    }

    def remark(self, size: float) -> str:
        d, unit = self.shape["d"], self.robot.position_units[self.joints[0]]
        return f"It turned round without a motion that shows: over how far below {d:.2g} {unit} is open."
