"""Writes before_and_after.toml: a simulated frame tested before and after its second story lost 15 % of its stiffness.

Each state is tested bare and with counterweights, to 0.1 % on frequencies and 1 % on shapes. Then

    cvxshear loop before_and_after.toml
"""

from pathlib import Path

import numpy as np

MASS = np.array([11.0, 9.5, 10.2, 8.7])
STIFFNESS = np.array([26e3, 24e3, 23e3, 21e3])
SOFTER = np.array([1.0, 0.85, 1.0, 1.0])
COUNTERWEIGHTS = {"bare": np.zeros(4), "loaded": np.array([0.0, 3.0, 0.0, 5.0])}

random = np.random.default_rng(2)


def modes(mass, k):
    """Frequencies, Hz, and shapes of a chain of masses on springs, a row a mode, with the noise of a test."""
    K = np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    root = np.sqrt(mass)
    eigenvalues, vectors = np.linalg.eigh(K / np.outer(root, root))
    shapes = (vectors / root[:, None]).T
    shapes /= np.abs(shapes).max(axis=1, keepdims=True)
    frequencies = np.sqrt(eigenvalues) / (2 * np.pi)
    return frequencies * (1 + 0.001 * random.standard_normal(4)), shapes + 0.01 * random.standard_normal((4, 4))


text = f'[frame]\nstory_heights = 0.4\ntotal_mass = {MASS.sum():.1f}\nreference = "before"\n'
for state, k in (("before", STIFFNESS), ("after", STIFFNESS * SOFTER)):
    for load, added in COUNTERWEIGHTS.items():
        frequencies, shapes = modes(MASS + added, k)
        text += f"""
[[configuration]]
name = "{state}, {load}"
state = "{state}"
added_mass = {added.tolist()}
frequencies = {frequencies.round(4).tolist()}
mode_shapes = {shapes.round(4).tolist()}
frequency_std = 0.001
mode_shape_std = 0.01
"""
Path("before_and_after.toml").write_text(text)
print("before_and_after.toml: 2 states, 4 tests")
