"""The faults that are tried, one file each."""

from sdp_vs_penalty.checks.faults.clock_rate import Clock
from sdp_vs_penalty.checks.faults.degrees import Degrees
from sdp_vs_penalty.checks.faults.delay import Delay
from sdp_vs_penalty.checks.faults.events import Beside
from sdp_vs_penalty.checks.faults.fault import Transformation
from sdp_vs_penalty.checks.faults.gain import Gain
from sdp_vs_penalty.checks.faults.mounting import Mounting
from sdp_vs_penalty.checks.faults.order import Exchange
from sdp_vs_penalty.checks.faults.saturation import Saturation
from sdp_vs_penalty.checks.faults.sign import Sign
from sdp_vs_penalty.checks.faults.weight import Weight
from sdp_vs_penalty.checks.faults.zero import Place

#: What is tried, in the order of the words; of what explains alike the first.
FAULTS: tuple[Transformation, ...] = (
    Degrees(),
    Clock(),
    Sign(),
    Exchange(),
    Mounting(),
    Weight(),
    Beside(),
    Gain(),
    Delay(),
    Place(),
    Saturation(),
)
