"""R-MADER re-implemented: decentralised, asynchronous B-spline planning that is robust to communication delay.

Kondo et al., RA-L 2023 (arXiv 2303.06222) on top of MADER (Tordesillas and How, T-RO 2021, arXiv 2010.11061), with the
adaptations of the paper: drones' goals are the vertices of the formation, balls are fitted parabolas, columns boxes.

spec            every setting
bspline, minvo  clamped cubic splines, the committed plan, the simplices that enclose their pieces
nnls, separator non-negative least squares, planes between two hulls
timing          how long a plan may take
hulls           columns, balls and other drones as vertices per spline interval
search          octopus search for a control polygon
backend         the convex programme that smooths it
planner         one replan: from a committed plan to a tentative one
deconfliction   stored plans, delay check, commitment
fleet           all drones of an episode on one simulated clock
"""
