"""Benchmarks: `make bench`, `hapticd bench` or `python -m bench [NAMES]`.

Errors of rendering, display and fits are written to docs/accuracy.md, times and rates to docs/benchmarks.md. Ratios are
computed only within one run, since machines differ and are shared.
"""
