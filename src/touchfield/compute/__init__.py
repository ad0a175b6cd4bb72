"""Compilation and execution of kernels: jit, CUDA, threads, processes, clusters."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
