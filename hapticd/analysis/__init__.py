"""Checks of configurations, calibration of devices, and reading of recordings of real surfaces.

    check         `hapticd check`: whether device, rate and grip can display the scene of a configuration
    calibration/  `hapticd calibrate`: mass and damping of handle and hand; `hapticd verify`: error of the display
    recordings/   recordings of surfaces in SI units on one clock, with their faults
    statistics    least squares with confidence intervals, robust regression
    drawing       helpers of all figures and result pages: matplotlib, SVG in a page, labels

Questions, and where to begin:

    Where do the results of `hapticd check` come from?
        check (check), which calls rendering: displayability, lagging_modes, driven_hand, scene_stability.
    How are mass and damping of a handle found?
        calibration/handle (calibrate); the fit itself is calibration/fit.
    Why is a recording of a surface refused?
        recordings/clock and recordings/files find the fault; fit/recording reports it as one error.
"""
