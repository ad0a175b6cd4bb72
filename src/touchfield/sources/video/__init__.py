"""Scenes from movies without depth: the forces show what catches the eye."""
