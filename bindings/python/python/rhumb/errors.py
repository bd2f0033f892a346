"""Exceptions of this package, one for each kind of error.

Each says in a sentence what was wrong and what to do.
"""


from typing import Iterable, NamedTuple, Optional, Tuple, Type


class Error(Exception):
    """A call failed."""


class InvalidError(Error, ValueError):
    """An argument is wrong; nothing was done."""


class NotInViewError(InvalidError, KeyError):
    """The view does not have the body: it is still to come, was removed, or was never there. "body in scene" asks for it."""

    def __str__(self) -> str:
        # A KeyError shows its words in quotes.
        return Exception.__str__(self)


class ClosedError(Error, ValueError):
    """The scene or connection is closed."""


class BusyError(Error, RuntimeError):
    """Another thread is inside a call of the same scene; nothing was done."""


class ConnectError(Error, ConnectionError):
    """The server was not reached, or is not the one that is trusted."""


class DeniedError(Error, PermissionError):
    """The server denied the request."""


class Refusal(NamedTuple):
    """A request that the server refused, and that changed nothing."""

    number: Optional[int]
    """The command's number, as the call that queued it returned it; None for a request for authority."""
    body: Optional[int]
    """The body that the request is about, if that is known."""
    reason: str
    """The reason in one or a few words, for programs, such as "unknown body"."""
    text: str
    """The reason, a sentence."""


class RefusedError(Error):
    """The server refused requests of earlier calls, which changed nothing.

    advance, wait and poll raise it after they have done their work: the tick is done, the view is computed, and the next
    call continues. number, body, reason and text are those of the first refusal; refusals has the first 1,024, and left_out is
    the number of further ones. Join with refusals="events" to get them as events alone.
    """

    refusals: Tuple[Refusal, ...]
    left_out: int

    def __init__(
        self,
        message: str,
        refusals: Iterable[Tuple[Optional[int], Optional[int], str, str]],
        left_out: int = 0,
    ) -> None:
        super().__init__(message)
        self.refusals = tuple(Refusal(*refusal) for refusal in refusals)
        self.left_out = left_out

    def __reduce__(self) -> Tuple[Type["RefusedError"], Tuple[str, Tuple[Refusal, ...], int]]:
        return type(self), (str(self), self.refusals, self.left_out)

    @property
    def number(self) -> Optional[int]:
        """The number of the first refused command; None for a request for authority."""
        return self.refusals[0].number

    @property
    def body(self) -> Optional[int]:
        """The body that the first refused request is about, if that is known."""
        return self.refusals[0].body

    @property
    def reason(self) -> str:
        """The first reason in one or a few words, for programs."""
        return self.refusals[0].reason

    @property
    def text(self) -> str:
        """The first reason, a sentence."""
        return self.refusals[0].text


class Timeout(Error, TimeoutError):
    """The server did not answer in time. The call may be repeated; nothing is lost."""


class EndedError(Error, ConnectionError):
    """The connection is over."""


class SceneGoneError(Error):
    """The scene was deleted, or its physics engine failed."""


class FaultError(Error, RuntimeError):
    """A fault of this library. The scene can only be closed."""
