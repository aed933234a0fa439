import numpy as np

STATES = ("open", "stick", "slip")


def classify(force, friction):
    f_n = force[:, :, 0]
    loaded = f_n > 1e-9 * np.maximum(f_n.max(axis=1, keepdims=True, initial=0.0), 1e-300)
    state = loaded.astype(np.int8)
    if force.shape[2] == 3:
        state[loaded & (np.hypot(force[:, :, 1], force[:, :, 2]) >= friction * f_n * (1 - 1e-6))] = 2
    else:
        state[loaded] = 2
    return state
