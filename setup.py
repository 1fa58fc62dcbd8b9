"""What pyproject.toml cannot say: the C extension and the abi3 tag of its wheel."""

from setuptools import setup

setup(
    cffi_modules=["hapticd/_build.py:ffibuilder"],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
