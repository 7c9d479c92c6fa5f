"""How robots move: kinematics, held commands and braking."""
