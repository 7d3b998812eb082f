"""The scoreboard: how accurate and how consistent the estimator is, recording by recording.

`subjects` says which recordings there are, `observe` runs the estimator over one and notes every
window beside the truth, `figures` reduces windows to figures and `verdicts` judges them. `table`
and `report` show the outcome, `compare` pairs two of them, `gates` holds a few short recordings
to recorded figures.
"""
