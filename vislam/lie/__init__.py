"""The rotation group SO(3) and the group of rigid motions SE(3), on plain arrays.

| operation | `so3` | `se3` |
|---|---|---|
| element | R, (..., 3, 3) | T, (..., 4, 4) |
| tangent | phi, (..., 3) | xi = (rho, phi), (..., 6) |
| `hat`, `vee` | phi^ | xi^, (..., 4, 4) |
| `ad` | phi^ | xi check, (..., 6, 6) |
| `exp`, `log` | phi of at most pi | idem |
| `inverse`, `adjoint`, `apply` | R^T, R, R p | T^-1, Ad_T, R p + t |
| `left_jacobian`, `right_jacobian`, and `..._inverse` | J_l, J_r | idem, (..., 6, 6) |
| `random` | uniform by the Haar measure | and a normal translation |

Every function takes any leading batch shape and is accurate to about 1e-13,
from zero to pi.

Source: Barfoot, State Estimation for Robotics (2017), chapter 7.
"""

from vislam.lie import se3, so3

__all__ = ["se3", "so3"]
