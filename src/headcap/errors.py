"""The one exception for input that a user can mend: value, expectation, remedy."""


class InputError(ValueError):
    """A recording, file or setting that cannot be used, told as value, expectation and remedy."""

    def __init__(self, found: str, *, expected: str, remedy: str) -> None:
        self.found, self.expected, self.remedy = found, expected, remedy
        super().__init__(f"{found}; expected {expected}. {remedy}")


class InputErrors(ValueError):
    """Several `InputError`s found in one check, told all at once."""

    def __init__(self, errors: list[InputError]) -> None:
        self.errors = tuple(errors)
        super().__init__("\n".join(f"- {error}" for error in errors))


class GateFailure(ValueError):
    """A stage's figure beyond the session's limit: what was measured, the limit, which recording, what to do."""
