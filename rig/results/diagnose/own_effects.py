"""Reads a file with effects of one's own, and checks the effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from identification.effects import EFFECTS, with_own
from identification.effects.effect import Effect
from identification.effects.own import EffectError
from rig.common.errors import InputError
from rig.common.provenance import sha256_file


@dataclass(frozen=True)
class OwnFile:
    """A file with effects of one's own."""

    path: Path | None = None  # the file; None for no file
    sha256: str = ""
    effects: tuple[Effect, ...] = ()  # its effects, in the order of their definition
    # Name of each effect that a function of the file injects into a simulated machine to it.
    injects: Mapping[str, Callable[..., float]] = field(default_factory=dict)

    @cached_property
    def catalogue(self) -> Mapping[str, Effect]:
        """The catalogue and the effects of the file, by name."""
        return with_own(self.effects)

    @property
    def record(self) -> dict[str, Any]:
        """What a result file has of the file; nothing without a file."""
        if self.path is None:
            return {}
        return {"effects_file": {"file": str(self.path), "sha256": self.sha256}}


NO_FILE = OwnFile()


def read_effects(path: Path | None) -> OwnFile:
    """Run a file of the user, and return the effects that it defines.

    Raises:
        InputError: The file cannot be read or run, has no effect, or an effect of it cannot be
            used; the message has file and line.
    """
    if path is None:
        return NO_FILE
    # Imported late: a diagnosis without such a file needs no driver.
    from drivers.errors import ConfigurationError
    from drivers.mock.plant.effects.own import injected, user_module

    try:
        digest = sha256_file(path)
        module = user_module(path)
        defined = [
            found
            for found in vars(module).values()
            if (isinstance(found, type) and issubclass(found, Effect) and _of(found, module))
            or (isinstance(found, Effect) and _of(type(found), module))
        ]
        own = tuple(with_own(list(dict.fromkeys(defined))).values())[len(EFFECTS) :]
        injects = {name: getattr(module, f"inject_{name}") for name in injected(path)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ConfigurationError, EffectError) as error:
        raise InputError(str(error)) from error
    if not own:
        raise InputError(
            f"{path}: has no effect; define a function with the decorator identification.effect, "
            "or a subclass of identification.Effect"
        )
    return OwnFile(path, digest, own, injects)


def _of(defined: type[Effect], module: Any) -> bool:
    return defined.__module__ == module.__name__ and not defined.__name__.startswith("_")
