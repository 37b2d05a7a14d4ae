"""JAX's persistent compilation cache, in a folder that is private to the user."""

import errno
import os
from importlib.metadata import version
from pathlib import Path

import jax

from sfgs_jax.arrays._errors import InputError

# Up to this version the CPU's loader prints two long error lines for every program in the cache, although it
# then runs it (jax#38445).
_LAST_NOISY_JAXLIB = (0, 10, 1)


def cache_folder() -> Path:
    """Folder of the compiled programs.

    It is the one that JAX was told (JAX_COMPILATION_CACHE_DIR), else `sfgs_jax/jaxlib-VERSION` in the user's
    cache folder (XDG_CACHE_HOME, else `~/.cache`).
    """
    return _chosen_folder() or _default_folder()


def enable_cache(folder: Path | str | None = None) -> Path:
    """Keep compiled programs on disk, so that the next process need not compile them again.

    JAX runs the programs that it finds, which are native code: nobody else may write the folder. So the
    default folder is made private (mode 0700) and must belong to the user. A chosen folder is used as it is.
    Every version of jaxlib has its own default folder.

    Args:
        folder: where to keep the programs; None means `cache_folder()`.

    Returns:
        The folder.

    Raises:
        InputError: the folder can't be made, or the default folder belongs to another user.
    """
    chosen = _chosen_folder() if folder is None else Path(folder).expanduser()
    folder = chosen or _default_folder()
    try:
        for missing in reversed([each for each in (folder, *folder.parents) if not each.exists()]):
            missing.mkdir(mode=0o700)
        if chosen is None:
            # Who can write the parent could replace the folder, so both are private.
            for own in (folder.parent, folder):
                if hasattr(os, "geteuid") and own.stat().st_uid != os.geteuid():
                    raise PermissionError(errno.EPERM, "it belongs to another user")
                own.chmod(0o700)
    except OSError as error:
        raise InputError(
            f"The compilation cache {folder} can't be used ({error.strerror}): "
            "set JAX_COMPILATION_CACHE_DIR to a folder of your own."
        ) from error
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # The dozens of programs that compile in a moment add up to a second too.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _silence_loader()
    return folder


def _chosen_folder() -> Path | None:
    told = os.environ.get("JAX_COMPILATION_CACHE_DIR") or jax.config.values["jax_compilation_cache_dir"]
    return Path(told) if told else None


def _default_folder() -> Path:
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return caches / "sfgs_jax" / f"jaxlib-{version('jaxlib')}"


def _silence_loader() -> None:
    installed = tuple(int(part) for part in version("jaxlib").split(".")[:3] if part.isdecimal())
    level = jax.config.values["jax_logging_level"]
    if installed <= _LAST_NOISY_JAXLIB and level == "NOTSET":
        # The first call also raises the level of the C++ messages; the second restores Python's only.
        jax.config.update("jax_logging_level", "CRITICAL")
        jax.config.update("jax_logging_level", level)
