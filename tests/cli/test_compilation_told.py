"""A line on the terminal while kernels compile, and none where they need not."""

from __future__ import annotations

import ctypes
import gc

import pytest
from numba import njit

from touchfield.cli.output import announce_compilation


def test_compilation_is_told_once_and_only_where_it_takes_place() -> None:
    kernels = [njit(lambda x: x + 1), njit(lambda x: x - 1)]
    lines: list[str] = []
    with announce_compilation(lines.append):
        assert [kernel(2) for kernel in kernels] == [3, 1]
    assert len(lines) == 1 and lines[0].startswith("compiling kernels") and gc.isenabled()
    with announce_compilation(lines.append):
        assert [kernel(2) for kernel in kernels] == [3, 1]
    assert len(lines) == 1


def test_an_interrupt_that_a_compiler_cannot_raise_ends_the_job(capfd: pytest.CaptureFixture[str]) -> None:
    @ctypes.CFUNCTYPE(None)
    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), announce_compilation(lambda line: interrupted()):
        njit(lambda x: x + 1)(2)
    assert not capfd.readouterr().err and gc.isenabled()
