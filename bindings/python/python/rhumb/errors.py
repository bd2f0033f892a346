"""Exceptions of this package, one for each kind of error.

Each says in a sentence what was wrong and what to do.
"""


class Error(Exception):
    """A call failed."""


class InvalidError(Error, ValueError):
    """An argument is wrong; nothing was done."""


class ClosedError(Error, ValueError):
    """The scene or connection is closed."""


class BusyError(Error, RuntimeError):
    """Another thread is inside a call of the same scene; nothing was done."""


class ConnectError(Error, ConnectionError):
    """The server was not reached, or is not the one that is trusted."""


class DeniedError(Error, PermissionError):
    """The server denied the request."""


class Timeout(Error, TimeoutError):
    """The server did not answer in time. The call may be repeated; nothing is lost."""


class EndedError(Error, ConnectionError):
    """The connection is over."""


class SceneGoneError(Error):
    """The scene was deleted, or its physics engine failed."""


class FaultError(Error, RuntimeError):
    """A fault of this library. The scene can only be closed."""
