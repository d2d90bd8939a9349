"""Limit cycles in closed loop: Figures 6 to 13, and what decides of them (section 3.2)."""
