"""What is found by measuring: configurations checked, devices calibrated, recordings of surfaces read.

    check         `hapticd check`: what of a configuration its device, rate and grip can carry
    calibration/  `hapticd calibrate` and `hapticd verify`: handle and hand measured, what is displayed compared
    recordings/   recordings of surfaces in SI units on one clock, with what is wrong in them
    statistics    least squares with intervals, robust regression
    drawing       what every figure and page of results shares: matplotlib, SVG in a page, labels

Questions, and where to begin:

    What does `hapticd check` say, and from what?
        check (check); its figures are those of rendering: displayability, lagging_modes, driven_hand, scene_stability.
    How are mass and damping of a handle found?
        calibration/handle (calibrate); the fit itself is calibration/fit.
    Why is a recording of a surface refused?
        recordings/clock and the reader of its format; fit/recording makes one refusal of it.
"""
