"""What is measured at a point.

Measures, each in its file:

    registry             measures by the names that a study's `measure` takes
    measure              what a measure is
    rest                 whether the closed loop comes to rest
    peaks                largest force and speed of a run
    quantile             a quantile of a field of the samples
    energy               energy that touched surfaces gave to the hand
    loop                 error of the closed loop against the continuous one
    continuous_wall      the continuous loop of a hand and one wall, in closed form
    onset                error of the time that is told of a touch
    margin               how far the scene is from instability, without a run
    display              displayed error of a material's tap, without a run
    passive_limit        the stiffness up to which a wall is passive, without a run
    displayed_materials  which of some materials a design of a joystick displays, without a run
    user_function        a function of the user's

A function of the user's:

    sweep_point          what it is given
    function_source      the source of its module
    function_values      what it returned, by column
    function_process     a process that calls it, and is ended where it hangs
    function_host        what runs in that process
"""
