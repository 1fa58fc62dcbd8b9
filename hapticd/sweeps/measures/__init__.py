"""Measures: the quantities that are measured at a point of a sweep.

    registry             the measures by their names in the study's key `measure`
    measure              the interface of a measure
    rest                 how the motion of the closed loop ends
    peaks                largest force and speed of a run
    quantile             quantile over time of a field of the samples
    energy               energy that touched surfaces gave to the hand
    loop                 difference between the sampled loop and the continuous loop
    continuous_wall      the continuous loop of a hand and one wall, in closed form
    onset                error of the reported time of a touch
    user_function        a Python function of the user, with the source of its module

Measures without a run:

    margin               margin of the scene to instability
    display              how far the displayed tap differs from the material's tap
    passive_limit        the stiffness up to which a wall is passive
    displayed_materials  the materials that a joystick can display

User functions:

    sweep_point          the argument of the function
    function_values      checks its return value
    function_process     the process that calls it, which is killed on a time-out
    function_host        the code that runs in that process
"""
