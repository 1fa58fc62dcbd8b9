"""What a person writes: configuration, scene, materials, operators, and their JSON Schema."""
