"""Import the right Pinocchio, or say in one sentence what to do.

Two other packages answer to the same name: PyPI's `pinocchio` (a nose plug-in) and a
ROS copy that PYTHONPATH puts in front of the wheel.
"""

from sdp_vs_penalty.errors import InputError

try:
    import pinocchio
except ImportError as error:
    if "failed to map segment" in str(error):  # a limit of memory
        raise MemoryError(str(error)) from error
    what = f"Pinocchio cannot be imported ({error})"
    remedy = (
        "run `pip install 'pin>=4,<5'` (PyPI's `pinocchio` is another package;"
        " uninstall it)"
    )
    raise InputError(what, remedy) from error

if not (hasattr(pinocchio, "rnea") and pinocchio.__version__.startswith("4.")):
    location = getattr(pinocchio, "__file__", None) or "a namespace package"
    raise InputError(
        f"`import pinocchio` finds {location}, which is not Pinocchio 4",
        "take that folder off PYTHONPATH (a ROS set-up script puts it there), or run"
        " `pip uninstall pinocchio` (another package), then `pip install"
        " --force-reinstall 'pin>=4,<5'`",
    )

pin = pinocchio
