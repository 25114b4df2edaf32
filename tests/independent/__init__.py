"""Independent truths: the closed loop of one joint, decided by other algorithms than the product's.

Nothing here imports gainroom. `joint` states the parameters, `delay_roots` decides continuous loops
(Routh in exact fractions at zero delay, then every root crossing as the delay grows; a Mikhailov count
and a subdivision root finder as second opinions), `sampled` decides sampled ones (matrix exponential
and Schur-Cohn in extended precision; eigenvalues as a second opinion), `margins` reads margins off a
dense frequency grid.
"""
