"""The one exception for input that a user can mend."""


class InputError(Exception):
    """Input that cannot be used.

    Args:
        where: the file, topic or parameter at fault.
        wrong: what is wrong with it.
        fix: what the user can do.
    """

    def __init__(self, where: object, wrong: str, fix: str) -> None:
        super().__init__(f"{where}: {wrong}; {fix}")
        self._parts = str(where), wrong, fix

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str]]:
        """Let it cross from one process to another."""
        return type(self), self._parts
