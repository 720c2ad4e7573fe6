"""Write 21 tests of one frame over three and a half years: a step, a slope, and the seasons.

python examples/many_tests.py && cvxshear history monitoring
"""

from pathlib import Path

import numpy as np

from cvxshear.io.toml import write_measurement

MASS = np.array([12.0, 11.0, 9.0])  # kg
STIFFNESS = np.array([38e3, 31e3, 26e3])  # N/m

rng = np.random.default_rng(7)
folder = Path("monitoring")
folder.mkdir(exist_ok=True)
for test in range(21):
    temperature = 10.0 + 12.0 * np.sin(np.pi * test / 3) + 3.0 * rng.standard_normal()
    k = STIFFNESS * (1.0 - 0.001 * (temperature - 10.0))  # 0.1 % softer per degree
    k[1] *= 0.97 if test >= 12 else 1.0  # story 2 lost 3 % after the twelfth test
    k[2] *= 1.0 - 0.05 * test / 20  # story 3 loses 5 % in all
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    values, vectors = np.linalg.eigh(stiffness / np.sqrt(np.outer(MASS, MASS)))
    shapes = (vectors / np.sqrt(MASS)[:, None]).T
    shapes /= np.abs(shapes).max(axis=1, keepdims=True)
    declared = {
        "name": "test",
        "date": f"{2020 + test // 6}-{1 + test % 6 * 2:02d}-15",
        "temperature": round(temperature, 1),
        "frequencies": np.sqrt(values) / (2 * np.pi) * (1.0 + 0.001 * rng.standard_normal(3)),
        "mode_shapes": shapes + 0.01 * rng.standard_normal((3, 3)),
        "frequency_std": 0.001,
        "mode_shape_std": 0.01,
        "damping_ratios": 0.01 * np.exp(0.1 * rng.standard_normal(3)),
    }
    table = {"frame": {"total_mass": float(MASS.sum())}, "configuration": [declared]}
    write_measurement(folder / f"{declared['date']}.toml", table)
print(f"{len(list(folder.glob('*.toml')))} files in {folder}")
