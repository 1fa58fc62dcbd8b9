"""Rendering: compiles a scene to the table that the servo's tick reads, judges its display, and renders offline.

Compiling:

    compiler/           converts scene and materials to the flat C records that a tick reads
    compensation        forces of a strike that make handle and hand accelerate as the material says
    filter_design       filters for coloured noise
    resampling          textures identified at one rate, as models for the servo's rate
    device_output       how forces reach the device (rates, delay, actuator), and the closed loop
    joystick            the simulated joystick and its operator as C objects

What can be displayed:

    displayability      which vibrations are muted, lowered, refused or displayed with a deviation
    undisplayable_text  a vibration above 0.4 of the rate, and the text that reports it; fast to import
    kept_contact        compensated taps that stay in contact with the surface
    lagging_modes       modes for which the actuator is too slow
    end_state           how a simulated motion ends: at rest, or in a cycle
    driven_hand         whether a texture keeps a light hand moving
    displayed_error     error of the handle's acceleration relative to the mode
    rearm               distance to which the probe must withdraw before it can tap a surface again
    plausibility        figures of materials that no known material has, and the unit that they may be in
    placement           objects that the handle cannot reach, or that hold it deep inside

Stability:

    scene_stability     the reported stability of a scene
    contact_sets        sets of surfaces that can be touched at the same time, and the stability of each set
    stability           stability of the loop of tick, device and hand, and margins of stiffness
    stability_remedy    stiffnesses to lower so that a contact set is safe
    stability_text      the report on a scene's stability in words
    surface_table       the arrays of a compiled table that the analysis of stability reads
    surface_properties  upper bounds of the stiffness, damping and noise of surfaces
    surface_margins     the margin of each surface alone, computed in microseconds
    disc_stiffness      stiffness of a disc along its radius and around its centre

Without a daemon:

    offline             `hapticd.render` and `hapticd.simulate`: the servo's own tick without clock and thread

Questions, and where to begin:

    How does a scene become a table?
        compiler/table (Compiler).
    How does `frequency_hz` become the recursion of a tick?
        config/modes (ModeKeys.mode) computes 2 pi f, compiler/material_record finds the mode of a tap or groove,
        compiler/mode_record computes the complex factor of one period; csrc/tick/hd_mode.c multiplies by this factor.
    Why is a mode silent, or lower than it should be?
        displayability (displayed_mode) decides; undisplayable() lists the result.
    Why is a scene called unsafe?
        contact_sets (margins) judges each set, by the limits and eigenvalues of stability.
    What is rendered offline, and how does it differ from the daemon?
        offline (render_run): the same tick, with time from 0 and without overruns.
"""
