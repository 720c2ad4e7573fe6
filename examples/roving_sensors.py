"""Write roving_sensors.toml: a six-story frame, simulated, measured with three sensors in three setups.

The top floor has a sensor in every setup, and the two others rove. Each setup is a test of its own: its frequencies
and its shapes have their own noise, scale and sign.
"""

import numpy as np
from scipy import linalg

from cvxshear.io.toml import write_measurement

MASS = np.full(6, 900.0)
STIFFNESS = 1e6 * np.array([2.0, 1.9, 1.8, 1.6, 1.4, 1.2])
SETUPS = {"low": [1, 2, 6], "middle": [3, 4, 6], "high": [4, 5, 6]}

T = np.eye(6) - np.eye(6, k=1)
eigenvalues, shapes = linalg.eigh((T * STIFFNESS) @ T.T, np.diag(MASS))
rng = np.random.default_rng(4)
configurations = []
for name, floors in SETUPS.items():
    frequencies = np.sqrt(eigenvalues[:4]) / (2 * np.pi) * (1 + 0.001 * rng.standard_normal(4))
    seen = shapes[np.array(floors) - 1, :4].T * rng.choice([-1, 1], (4, 1)) * rng.uniform(0.5, 2, (4, 1))
    seen += 0.01 * np.max(np.abs(seen), axis=1, keepdims=True) * rng.standard_normal(seen.shape)
    configurations.append({
        "name": name, "state": "bare", "measured_floors": floors, "frequencies": frequencies.round(4).tolist(),
        "mode_shapes": seen.round(5).tolist(), "frequency_std": 0.001, "mode_shape_std": 0.01,
    })  # fmt: skip
declared = {"frame": {"stories": 6, "total_mass": 5400.0}, "configuration": configurations}
write_measurement("roving_sensors.toml", declared)
for each in configurations:
    print(f"{each['name']}: floors {each['measured_floors']}, {each['frequencies']} Hz")
