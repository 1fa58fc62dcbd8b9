"""From scene and materials to the table that the tick reads: flat C records in the units of a tick.

table            the compiler itself: keeps slots, rewrites the records of what changed
records          arrays of C records that grow in place, and their free places
walls            the pieces of walls with patches
materials        the materials of a scene: records, noises and the numbers of both
material_record  the record of one material, and the numbers that it has beside
mode_record      the numbers of one mode at the rate
mode_tables      modes that follow speed or force: what the tick looks up when it strikes them
noise_filters    the filters of textures that are noise
"""
