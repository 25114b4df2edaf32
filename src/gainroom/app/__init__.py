"""The interactive page: gains are dragged, and verdict, gain map, Bode plot, step and critical mode follow."""
