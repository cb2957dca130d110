"""A search of your own: signs and parameters are fitted in turn, from random signs."""

from dataclasses import dataclass

import numpy as np

import bayesid
from bayesid.signs.search.protocol import Search, SearchResult


@dataclass(frozen=True)
class InTurn(Search):
    """The best of some descents; each ends in a local minimum, so nothing is proven."""

    starts: int = 30

    def find(self, problem, steps=lambda done, total: None):
        """The cheapest descent."""
        equations, solver, rng = problem.normal_equations, problem.solver().prepared(), np.random.default_rng(0)
        descents = []
        for start in range(self.starts):
            signs, last = rng.choice([-1, 1], len(equations)), None
            while not np.array_equal(signs, last):
                last = np.where(equations.known != 0, equations.known, signs)
                solution = solver.solve(last @ equations.gradient)
                predicted = equations.gradient @ problem.coefficients.project(solution.theta)
                signs = np.where(equations.known != 0, equations.known, np.where(predicted >= 0.0, 1, -1))
            descents.append(SearchResult(last, solution.theta, problem.energy + solution.cost, "in turn"))
            steps(start + 1, self.starts)
        return min(descents, key=lambda result: result.cost)


if __name__ == "__main__":
    log = bayesid.simulate("kr5-paper", duration=8.0, rate=50.0, noise=0.1, rng=3)
    proven = bayesid.identify("kr5-paper", log, terms=["rigid_body"], posterior=False)
    descent = bayesid.identify("kr5-paper", log, terms=["rigid_body"], search=InTurn(), posterior=False)
    same = (descent.sample_signs == proven.sample_signs).mean()
    print(f"{descent.search.method}: certified {descent.search.certified}, {same:.1%} of the proven signs")
