"""The note on the terminal while kernels compile."""

from __future__ import annotations

import ctypes
import gc

import pytest
from numba import njit

from touchfield.cli.output import announce_compilation


def test_compilation_is_noted_once_and_only_if_it_happens() -> None:
    kernels = [njit(lambda x: x + 1), njit(lambda x: x - 1)]
    lines: list[str] = []
    with announce_compilation(lines.append):
        assert [kernel(2) for kernel in kernels] == [3, 1]
    assert len(lines) == 1 and lines[0].startswith("compiling kernels") and gc.isenabled()
    with announce_compilation(lines.append):
        assert [kernel(2) for kernel in kernels] == [3, 1]
    assert len(lines) == 1


def test_interrupt_within_a_callback_of_the_compiler_ends_the_command(
    capfd: pytest.CaptureFixture[str],
) -> None:
    @ctypes.CFUNCTYPE(None)
    def raise_interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), announce_compilation(lambda line: raise_interrupt()):
        njit(lambda x: x + 1)(2)
    assert not capfd.readouterr().err and gc.isenabled()
