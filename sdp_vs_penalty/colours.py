"""One colour a meaning, in report, page, notebooks and figures: measured is black, a
model before a change grey, after it blue.

Okabe, Ito, "Color universal design" (2008): people who see no red or no green tell these
colours apart. A violet stands for the yellow, which is too pale on white.
"""

#: All colours that count through something, such as the joints of an arm.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A6FDF")
#: Dark pages draw it in the colour of their text.
MEASURED = "#000000"
#: The first model, before something was added.
BEFORE = "#888888"
#: A model alone, or the last one, after something was added.
AFTER = "#0072B2"
#: What was added.
ADDED = "#D55E00"
#: Axes, their words, and what is only background.
NEUTRAL = "#888888"


def model_colour(k: int, n_models: int) -> str:
    """Return the colour of a model: the last is drawn as "after", the first as
    "before".

    Parameters
    ----------
    k : int
        Index of the model, from 0.
    n_models : int
        Number of models in the figure.
    """
    if k == n_models - 1:
        return AFTER
    return BEFORE if k == 0 else PALETTE[1 + k % (len(PALETTE) - 1)]
