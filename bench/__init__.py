"""What is measured rather than asserted: `make bench` or `python -m bench [NAMES]`.

Speed goes to docs/benchmarks.md, error against references to docs/accuracy.md. Ratios are taken within one run only,
since machines differ and are shared.
"""
