"""Draw the stored pictures again, after a change that is meant to be seen: then look at them."""

from pathlib import Path

import gymnasium as gym

import octoarm_env
from octoarm_env.rendering.toolkit import pygame


def main() -> None:
    for target in octoarm_env.LIMIT_CYCLES:
        for overlay in (True, False):
            env = gym.make(
                "OctoArm-v0",
                target=target,
                render_mode="rgb_array",
                width=320,
                height=240,
                overlay=overlay,
            )
            teacher = octoarm_env.TeacherPolicy(env)
            observation, _ = env.reset(seed=3)
            for _ in range(60):
                observation, *_ = env.step(teacher.predict(observation)[0])
            surface = pygame.surfarray.make_surface(env.render().swapaxes(0, 1))
            name = f"{target}{'_overlay' if overlay else ''}.png"
            pygame.image.save(surface, Path(__file__).parent / name)


if __name__ == "__main__":
    main()
