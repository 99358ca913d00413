"""Slow parts of SciPy are imported where they are used."""

import subprocess
import sys

from small_runs import write_run

from sdp_vs_penalty import load_problem

SLOW = ["scipy.interpolate", "scipy.ndimage", "scipy.integrate", "scipy.signal"]


def test_slow_parts_of_scipy_are_imported_where_they_are_used(tmp_path):
    """In one process, which imports everything once: neither the check nor
    identification after it needs one of the slow parts."""
    run = tmp_path / "run.csv"
    write_run(run, load_problem("two_link"), seconds=8.0)
    program = (
        f"import sys; import sdp_vs_penalty as sdp; run = {str(run)!r}; "
        "import sdp_vs_penalty.estimation.identify; sdp.load_measurements(run); "
        "sdp.check('two_link', run); "
        "sdp.identify('two_link', run); "
        f"print([name for name in {SLOW} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True
    )
    assert done.stdout == "[]\n", done.stderr
