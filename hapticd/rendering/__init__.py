"""From configuration to what a tick needs: tables, filters, compensation, stability; rendering offline.

Compiling:

    compiler/           scene and materials become the flat C records that a tick reads
    compensation        what is struck for a mode, so that handle and hand accelerate as the library says
    filter_design       filters for coloured noise
    resampling          textures identified at one rate, as models for the servo's
    device_output       what rendering has to know of the device: how forces come out, and what closes its loop
    joystick            the simulated joystick and its operator as C objects

What can be shown:

    displayability      what of scene and materials is muted, lowered, refused or shown otherwise
    undisplayable_text  one mode that the rate cannot carry, and its sentence; cheap to load
    lagging_modes       modes that the actuator is too slow for
    end_state           how a simulated motion ends: at rest, or in a cycle
    driven_hand         whether a texture drives a light hand along by itself
    displayed_error     how far the handle's acceleration is from what was wanted
    rearm               how far the probe must have been away to tap a surface again

Stability:

    scene_stability     the stability of a scene as it is reported
    contact_sets        which surfaces can be touched together, and how stable each set is
    stability           whether the loop of tick, device and hand is stable: margins of stiffness
    stability_remedy    what to lower so that a set is safe
    stability_text      what a person reads of it
    surface_table       the part of a compiled table that the analysis reads
    surface_properties  what surfaces push back with, at most
    surface_margins     the margin of each surface by itself, in microseconds
    disc_stiffness      how stiff a disc is along its radius and around it

Without a daemon:

    offline             `hapticd.render` and `hapticd.simulate`: the servo's own tick without clock and thread

Questions, and where to begin:

    How does a scene become a table?
        compiler/table (Compiler).
    How does `frequency_hz` become what a tick advances?
        config/modes (ModeKeys.mode) makes it 2 pi f, compiler/material_record finds the mode of a tap or groove,
        compiler/mode_record makes it the rotor of one period, which csrc/tick/hd_mode.c advances.
    Why is a mode silent, or lower than it should be?
        displayability (displayed_mode) decides; undisplayable() lists what it did.
    Why is a scene called unsafe?
        contact_sets (margins) gives the verdict of each set, by the limits and eigenvalues of stability.
    What is rendered offline, and how does it differ from the daemon?
        offline (render_run): the same tick, time from 0, no faults of timing.
"""
