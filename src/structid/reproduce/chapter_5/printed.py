"""What the dissertation prints in Tables 5.1 and 5.2.

References
----------
Norris (1986), chapter 5.
"""

import numpy as np

from structid.arrays import locked

#: Table 5.1, simply supported beam, rad/s.
BEAM_ACTUAL = locked(
    [0.09870, 0.39478, 0.88826, 1.57914, 2.46740, 3.55306, 4.83611, 6.31655, 7.99438, 9.86960], np.float64
)
BEAM_IDENTIFIED = locked(
    [0.09834, 0.39433, 0.88821, 1.57910, 2.46734, 3.55311, 6.68212, 8.49410, 10.19992, 11.46529], np.float64
)
BEAM_ERROR = locked([0.4, 0.1, 0.0, 0.0, 0.0, 0.0, -38.2, -34.5, -27.6, -16.2], np.float64)

#: Table 5.2, free square membrane, labelled rad/s.
MEMBRANE_ACTUAL = locked(
    [
        *(0.0, 1.1912, 1.1915, 2.7641, 5.8445, 5.8544, 7.8315, 9.4418),
        *(12.0, 12.0, 15.3027, 16.0685, 17.8975, 25.1564, 25.6702, 29.5497),
    ],
    np.float64,
)
MEMBRANE_IDENTIFIED = locked([0.0, 1.1835, 1.1948, 2.7669, 5.8482], np.float64)
MEMBRANE_ERROR = locked([0.0, 0.6, -0.3, -0.1, -0.1], np.float64)
