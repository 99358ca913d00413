"""How a contract that is not kept is said."""


class ContractError(AssertionError):
    """A plug-in does not keep a contract."""


def demand(kept: object, sentence: str) -> None:
    """Raise ContractError with a sentence unless a condition holds."""
    if not kept:
        raise ContractError(sentence)
