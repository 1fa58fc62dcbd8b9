"""What is measured rather than asserted: `make bench`, `hapticd bench` or `python -m bench [NAMES]`.

How wrong what is rendered, displayed and fitted is goes to docs/accuracy.md, times and rates to docs/benchmarks.md.
Ratios are taken within one run only, since machines differ and are shared.
"""
