"""The memory that the player's process and the servo's share: where all lies in it, and who writes it."""
