"""Steps of a teardown: an error in one step does not prevent the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import DeviceError
from drivers.interfaces import Servo, ServoState
from rig.common.errors import StorageError

T = TypeVar("T")


def words_of(error: BaseException) -> str:
    """Return an exception's class and message, even if its ``__str__`` fails."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - the class alone is shown if the message fails
        return type(error).__name__


class Steps:
    """Runs steps in order, and stores their errors.

    Attributes:
        problems: Text of each error.
        unforeseen: Exceptions other than device errors, storage errors and Ctrl-C, each once.
        interrupted: Whether Ctrl-C interrupted a step.
        cut: Why the power was cut instead of a ramp; empty if it was not.
    """

    def __init__(self) -> None:
        self.problems: list[str] = []
        self.unforeseen: list[BaseException] = []
        self.interrupted = False
        self.cut = ""

    def attempt(self, step: Callable[[], object]) -> BaseException | None:
        """Run one step; store its error, if any, and return it."""
        return self.result(step)[1]

    def result(self, step: Callable[[], T]) -> tuple[T | None, BaseException | None]:
        """Run one step; return its value and None, or None and its error, which is stored."""
        try:
            return step(), None
        except KeyboardInterrupt as error:
            self.problems.append("interrupted again while stopping")
            self.interrupted = True
            return None, error
        except (DeviceError, StorageError) as error:
            self.problems.append(str(error))
            return None, error
        except BaseException as error:  # noqa: BLE001 - a defect must not keep the power on
            words = f"unforeseen {words_of(error)}"
            if words not in self.problems:
                self.unforeseen.append(error)
            self.problems.append(words)
            return None, error

    def take_first(self, others: Steps) -> None:
        """Store the first error of steps that were repeated, and whether one was interrupted."""
        self.problems += others.problems[:1]
        self.unforeseen += others.unforeseen[:1]
        self.interrupted = self.interrupted or others.interrupted

    def state(self, servo: Servo) -> ServoState | None:
        """Read the drive's state; return None if the read fails."""
        return self.result(servo.state)[0]
