"""The extension of `touchfield-core`: one module for every Python from 3.11 on."""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "touchfield_core",
            ["touchfield_core.c"],
            include_dirs=["../c"],
            define_macros=[("Py_LIMITED_API", "0x030b0000")],
            py_limited_api=True,
            extra_compile_args=["-O3", "-std=c99"],
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
