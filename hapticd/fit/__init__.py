"""Fits of materials to recordings of an instrumented stylus, for `hapticd fit`.

    from_files      reads files, runs a fit, selects its values for the material: begin here
    options         options of a fit
    recording       reads and saves recordings in SI units on a uniform clock
    preparation     prepares recordings for every fit: impossible samples, gaps, units, rate, motion
    limits          thresholds of all fits, with unit and reason

The fits, one for each kind of recording; each finds onsets, fits a model, and gives intervals and a verdict:

    tap             taps that ring: slope, frequency, decay
    waveform        taps that are pulses
    grooves         spacing, mode and strength of grooves
    texture         rough textures: peak and mean frequency, loudness, autoregressive models
    puncture        membranes: stiffness, depth and force of the rupture, its mode

Shared by the fits:

    ringing         decaying sinusoids in a section of acceleration, by variable projection
    speed_law       the amplitude of taps as a function of the approach speed: a line, a power law or a table
    spectral_lines  hum and other tones
    verdict         exclusions with their reasons; good, fair or poor, with the reasons
    result          base class of the results; fits as plain data for JSON

Results:

    contribution    the keys that a fit adds to a material, with their provenance, and the new material
    report, panels  the report, an HTML page, and the pictures for each kind of fit
    synthesize      synthetic recordings with known parameters

Least squares, robust regression and the reading of files are in hapticd.analysis.
"""
