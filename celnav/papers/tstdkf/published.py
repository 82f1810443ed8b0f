"""Numbers of the paper's text; the bodies of its tables are lost."""

POSITION_BELOW = {"ekf": 56.49, "tkf": 35.18}
"""By how many percent the position RMSE of TSTDKF is below that of EKF and TKF in setting 1."""
VELOCITY_BELOW = {"ekf": 27.66, "tkf": 17.07}
