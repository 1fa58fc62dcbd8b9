"""From recordings of an instrumented stylus to materials: what `hapticd fit` does.

Reading:

    recording           reads recordings into SI units on a uniform clock; documented (`hapticd.fit.recording.save`)
    recording_checks    what every fit checks first: acceleration, force, units, rate
    stylus_motion       position and speed along the surface
    invalid_samples     invalid samples: replaced by straight lines, or refused
    stretches           the whole stretches between gaps and clipped samples
    duplicates          the same recording twice in a set
    exclusions          what is left out of a fit, and why

The fits, each of one kind of recording:

    from_files          reads files, runs a fit, says what goes into the material: begin here
    options             what may be asked of a fit, and the fit that does it
    tap                 taps that ring: slope, frequency, decay
    waveform            taps that are pulses
    tap_kind            which of these two a set of taps is
    taps/               taps found, fitted one by one, and the law of all
    grooves             spacing, mode and strength of grooves
    strikes/            strikes of grooves: found, fitted stroke by stroke, numbered
    texture             rough textures: peak and mean frequency, loudness
    texture_blocks      strokes over a texture in blocks of half a second
    autoregressive      autoregressive models of a texture
    puncture            membranes: stiffness, depth and force of the rupture, its mode

Spectra:

    spectral_lines      hum and other tones
    spectrum_peak       the peak of a mean spectrum, and its interval
    spectral_distance   how far a model's spectrum is from a recorded one, dB

Results:

    verdict             good, fair or poor, with the thresholds of all fits
    contribution        what a fit gives to a material, and the material as the loader takes it
    provenance          where its figures come from
    assumptions         the stiffness of a material whose recordings do not determine it
    plain_data          fits as plain data for JSON
    report              the report: an HTML page
    panels              what the report of each kind of fit draws

Recordings whose truth is known:

    synthesize          what a stylus is, and recordings of taps
    synthesize_strokes  recordings of strokes and punctures

Least squares and robust regression are in analysis/, as are the files themselves (analysis/recordings/).

Questions, and where to begin:

    How is a tap found and fitted?
        taps/events (events_of), fitted by taps/ringing (fit_ringing); tap (fit_tap) puts them together.
    Why is a verdict fair or poor?
        verdict (Doubts) has the thresholds; each fit reports its doubts in functions named _doubt_...
    Why is a recording left out?
        recording (load) and exclusions (Exclusions).
"""
