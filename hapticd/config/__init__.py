"""Documents that people write: configuration, scene, materials, operators, and their JSON Schema.

Documents, each validated by a model:

    configuration        the complete configuration: servo, device, materials and scene, from YAML files or a mapping
    scene                the objects in the workspace, patches of walls, and which forces are displayed
    materials            what a surface is made of, and the shipped library
    modes                the ringing mode, Q(t) = A exp(-B t) sin(w t): its keys, its direction, tables over the speed
    waveform             a tap as a short curve of samples
    texture              what a surface feels like while the probe strokes along it: grooves, noise
    operator             motion of the simulated hand: waypoints or a gesture
    hid                  `device.hid` and `device.replay`
    actuator             the actuator as a lag between command and force
    dynamics             mass and damping of handle and hand

Files:

    locations            which files the configuration is read from
    shipped_files        shipped scenes, operators and materials, by name
    document_kinds       recognizes the kind of a document by its keys: scene, materials, configuration, operator
    change_files         reads materials and a scene from files, for one change of a running daemon
    file_faults          finds file, line and column of a fault that the daemon reports
    schema               JSON Schema of the configuration, for editors

Questions, and where to begin:

    Where is a key defined, with its range and its description?
        In the model of its document: `servo` and `device` in configuration (Servo, Device), objects in scene.
    Which file did a value come from?
        locations (choose) finds the files; configuration (load_config) merges them in order.
    How is the line of a fault found?
        base/yaml_source keeps the lines; file_faults (placed) finds them for faults that the daemon reports.
"""
