"""How live localization does: `vapor-track live` in a process of its own, beside a robot that is played to it."""
