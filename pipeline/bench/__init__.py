"""What a workshop needs around it: kits as files, the servo player, videos of a tank."""
