"""What is measured rather than asserted: `make bench`, `hapticd bench` or `python -m bench [NAMES]`.

What each kernel costs beside how wrong it is goes to docs/accuracy.md, what is speed alone to docs/benchmarks.md.
Ratios are taken within one run only, since machines differ and are shared.
"""
