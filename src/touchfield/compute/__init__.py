"""How kernels are compiled and where they run: jit, CUDA, threads, processes and clusters."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
