"""Compiles the package's inner loops (*kernels*) with numba, and runs them on threads, a GPU, worker
processes or a cluster."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
