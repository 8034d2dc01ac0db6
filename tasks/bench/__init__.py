"""What a workshop needs of science: parts, servos, tracked throws and tags, in millimetres and microseconds."""
