"""From recordings of an instrumented stylus to materials: what `hapticd fit` does.

    from_files      reads files, runs a fit, says what goes into the material: begin here
    options         what may be asked of a fit
    recording       reads recordings into SI units on a uniform clock; documented (`hapticd.fit.recording.save`)
    preparation     what every fit does with a recording first: invalid samples, whole stretches, units, rate, motion

The fits, each of one kind of recording, from onsets over the model and its intervals to the verdict:

    tap             taps that ring: slope, frequency, decay
    waveform        taps that are pulses
    grooves         spacing, mode and strength of grooves
    texture         rough textures: peak and mean frequency, loudness, autoregressive models
    puncture        membranes: stiffness, depth and force of the rupture, its mode

What they share:

    ringing         decaying sinusoids in a stretch of acceleration, by variable projection
    speed_law       the amplitude of taps over the approach speed: a line, a power law or a table
    spectral_lines  hum and other tones
    verdict         what is left out and why; good, fair or poor, with all thresholds and reasons
    result          what every fit gives, and fits as plain data for JSON

What comes of a fit:

    contribution    what a fit gives to a material, with its provenance, and the material as the loader takes it
    report, panels  the report: an HTML page, and what it draws of each kind of fit
    synthesize      recordings whose truth is known

Least squares and robust regression are in analysis/, as are the
files themselves (analysis/recordings/).
"""
