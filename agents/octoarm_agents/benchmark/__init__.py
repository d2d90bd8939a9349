"""Speed and agreement benchmarks of the arm against an independent physics engine."""
