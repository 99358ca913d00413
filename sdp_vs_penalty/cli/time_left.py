"""How long a piece of work still takes."""

import re
import time
from collections.abc import Callable

#: "3 of 40" in what a long computation says.
_COUNT = re.compile(r"\b(\d+) of (\d+)\b")


class TimeLeft:
    """The time left, estimated from texts that count, such as "run 3 of 40"."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start the clock, which returns seconds."""
        self._clock = clock
        self._begin = clock()
        self._first = 0
        self._work = ""

    def with_time_left(self, text: str) -> str:
        """Append the time left to the state of some work, estimated from its pace so
        far.

        Parameters
        ----------
        text : str
            The state, such as "run 3 of 40".

        Returns
        -------
        str
            The same text if it counts nothing, says the time left already, or less than
            five seconds are left.
        """
        count = _COUNT.search(text)
        if count is None or " left" in text:
            return text
        done, total = int(count[1]), int(count[2])
        work = text[: count.start()] + count[2]
        if work != self._work:  # another piece of work begins
            self._work = work
            self._begin = self._clock()
            self._first = done
        if done <= self._first:
            return text
        pace = (self._clock() - self._begin) / (done - self._first)
        seconds = pace * (total - done)
        if seconds < 5.0:
            return text
        minutes, full_seconds = divmod(round(seconds), 60)
        time_text = f"{full_seconds} s"
        if minutes:
            time_text = f"{minutes} min {time_text}"
        return f"{text}, about {time_text} left"
