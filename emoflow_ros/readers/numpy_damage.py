"""What NumPy makes of damaged files of arrays."""

import warnings
from collections.abc import Generator
from contextlib import contextmanager

from emoflow_ros.errors import InputError


@contextmanager
def damage_as_value_error() -> Generator[None]:
    """Make a ValueError of whatever NumPy raises on damaged bytes, and silence its warnings.

    An array's header is Python source: its parser raises SyntaxError, TokenError, SystemError,
    and sizes that cannot be raise OverflowError or MemoryError.

    Raises:
        ValueError: any of them.
        OSError, KeyError: a file that cannot be read, an array that is not there.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (InputError, OSError, KeyError, ValueError):
        raise
    except MemoryError:
        raise ValueError("or larger than the memory") from None
    except Exception as error:  # zipfile and zlib have their own, too
        reason = " ".join(str(error).split())
        raise ValueError(f"{reason or type(error).__name__}") from error
