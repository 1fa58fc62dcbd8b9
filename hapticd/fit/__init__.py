"""Fits of materials to recordings of an instrumented stylus: what `hapticd fit` does.

    from_files      reads files, runs a fit, selects what goes into the material: begin here
    options         options of a fit
    recording       reads recordings into SI units on a uniform clock; documented (`hapticd.fit.recording.save`)
    preparation     what every fit does with a recording first: impossible samples, gaps, units, rate, motion
    limits          thresholds of all fits, with unit and reason

The fits, each of one kind of recording, from onsets over the model and its intervals to the verdict:

    tap             taps that ring: slope, frequency, decay
    waveform        taps that are pulses
    grooves         spacing, mode and strength of grooves
    texture         rough textures: peak and mean frequency, loudness, autoregressive models
    puncture        membranes: stiffness, depth and force of the rupture, its mode

What they share:

    ringing         decaying sinusoids in a section of acceleration, by variable projection
    speed_law       the amplitude of taps over the approach speed: a line, a power law or a table
    spectral_lines  hum and other tones
    verdict         exclusions with their reasons; good, fair or poor, with the reasons
    result          base class of the results; fits as plain data for JSON

What is made of a fit:

    contribution    what a fit adds to a material, with its provenance, and the material as the loader takes it
    report, panels  the report: an HTML page, and the pictures of each kind of fit
    synthesize      synthetic recordings with known parameters

Least squares and robust regression are in analysis/, and so is the reading of files (analysis/recordings/).
"""
