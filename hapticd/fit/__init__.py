"""From recordings of an instrumented stylus to materials: what `hapticd fit` does.

recording.py reads and checks, ringing.py fits decaying sinusoids, regression.py lays lines through what comes out,
tap.py and its neighbours make materials of it, synthesize.py makes recordings whose truth is known.
"""
