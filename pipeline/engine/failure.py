"""Any exception as an exit status and one line for people."""

from __future__ import annotations

from pipeline.errors import ImpastoError


def in_one_line(error: BaseException) -> tuple[int, str]:
    """Return the exit status and the line; what is not foreseen is called an internal error."""
    match error:
        case ImpastoError():
            status, text = error.exit_status, str(error)
        case KeyboardInterrupt():
            status, text = 130, "interrupted; what was finished is kept"
        case OSError():
            where = f"{error.filename}: " if error.filename else ""
            status, text = 1, f"{where}{error.strerror or error}"
        case MemoryError():
            status, text = 1, f"not enough memory ({error})" if str(error) else "not enough memory"
        case _:
            status = 1
            text = (
                f"internal error, {type(error).__name__}: {error}; "
                "please report it; --debug shows where it comes from"
            )
    return status, " ".join(text.split())
