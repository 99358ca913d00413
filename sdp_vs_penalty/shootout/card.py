"""The texts that go with the library of instances: data card and citation."""

from __future__ import annotations

CARD = """# Identification SDPs with proved optima

{count} semidefinite programs from the physically consistent identification of robot dynamics, {proved}
of them with a proof of the optimum, or that there is none. Written by sdp-vs-penalty shootout --export.

## What is in a folder

| file | content |
| --- | --- |
| problem.cbf | conic benchmark format, version 3 |
| problem.dat-s | sparse SDPA (where there is no exponential cone) |
| problem.npz, problem.mat | c, A, b, cones: minimise c'x subject to b - A x in the cones, in order |
| FILE.json | loss = offset + scale * (optimum of FILE); proved bounds of the loss; SHA-256 |
| proof.json | the proof: `sdp-vs-penalty verify DIR`, or `python verify_proof.py proof.json` |

The numbers of problem.npz and problem.mat are those of problem.cbf, whose JSON holds for them too. A
matrix of order d stands in the rows as its upper triangle, column by column, off-diagonal entries times
the square root of 2; "soc" is |u| <= s with s first; "exp" is y exp(x / y) <= z, y > 0; "zero" means
equal. index.csv has a row for each instance: status, difficulty, interval, sizes, SHA-256, a sentence.

A solver's optimum is right to a relative accuracy eps if offset + scale * optimum lies within
[lower, upper], widened by eps times the loss. The proofs are of the identification problem, in rational
arithmetic; a file holds its numbers after centring and scaling, rounded to doubles. "difficulty" is easy
where our own certified gap is at most 1e-8 of the loss, medium up to 1e-6, else hard.

## Where the numbers come from

Simulated robots (two_link, panda, ur10e, emps, tx40), random chains of 2 to 60 links from seeds, and,
where the measurements were at hand, the public runs of these robots, reduced to a triangular factor by
orthogonal transformations. "hostile" instances change one thing: units, scaling, rank, noise, bounds.
How the factor came from measured samples is outside of the proofs. Nothing in here is personal data.

## Licence and citation

BSD 3-Clause, as sdp-vs-penalty; instances made of measurements also under the terms of those who
published these. To cite, see CITATION.cff.
"""

CITATION = """cff-version: 1.2.0
message: "If you use these instances, please cite them as below."
title: "Identification SDPs with proved optima"
type: dataset
license: BSD-3-Clause
authors:
  - name: "The sdp-vs-penalty authors"
"""
