"""A known scene, under a cover, on a bus."""

from tactiled.simulate.playback import Player, answer, check_scene, play, player
from tactiled.simulate.scenes import SCENES

__all__ = ["SCENES", "Player", "answer", "check_scene", "play", "player"]
