"""Print M, C, g, Y_d and Y_k of a small robot entry by entry."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Final, final

import casadi as ca
import numpy as np

from dmframe.common.errors import ValueFault
from dmframe.regressor.export import kinematic_names, kinematic_values
from dmframe.regressor.full import full_regressor
from dmframe.regressor.polynomial import Polynomial, expand
from dmframe.regressor.readable import Groups, Style, Term, latex_name, terms_of
from dmframe.robot.chain import SerialChain
from dmframe.robot.parameters import DynamicParameters, Part
from dmframe.robot.symbolic import SymbolicRobot

MOST_JOINTS: Final = 3
_FRICTION: Final[dict[Part, str]] = {"rotor": "ddq_ref", "viscous": "dq_ref", "coulomb": "phi"}


@final
@dataclass(frozen=True)
class Matrix:
    """Matrix of readable sums; `entries` by row. `columns` are the column names, if any."""

    name: str
    arguments: str
    entries: tuple[tuple[tuple[Term, ...], ...], ...]
    columns: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class WrittenOut:
    """A robot's equations written out.

    Parameters
    ----------
    M, C, g
        Matrices of M ddq + C(q, dq) dq + g; parameters that are zero in the robot's model are omitted.
    Y_d
        Nonzero columns of the regressor; likewise `Y_k`, whose product with a_k is J psi.
    numbers
        Translations, inertial parameters and gravity by name, in SI units.
    left_out
        Parameters omitted from M, C and g.
    """

    chain: SerialChain
    M: Matrix
    C: Matrix
    g: Matrix
    Y_d: Matrix
    Y_k: Matrix
    numbers: dict[str, float] = field(repr=False)
    left_out: tuple[str, ...] = ()

    @property
    def matrices(self) -> tuple[Matrix, ...]:
        """All five matrices."""
        return self.M, self.C, self.g, self.Y_d, self.Y_k


def write_out(chain: SerialChain, friction: Collection[str] = (), keep: Sequence[int] | None = None) -> WrittenOut:
    """Expand the equations of a robot of up to three joints.

    Parameters
    ----------
    friction : any of "viscous", "coulomb", "rotor", as columns of Y_d
    keep : columns of Y_d, such as `BaseParameters.independent`; all by default

    Raises
    ------
    ValueFault
        For a larger robot.
    UnknownNameError
        For another kind of friction.
    """
    regressor = full_regressor(chain, friction)
    if chain.n > MOST_JOINTS:
        raise ValueFault(
            f"{chain.name}: expected at most {MOST_JOINTS} joints to write out, found {chain.n}, whose Y_d takes "
            f"{regressor.function.n_instructions()} operations; fix some joints, or generate code (--c, --python)"
        )
    return _Writer(chain).whole(friction, keep)


@final
class _Writer:
    """Names, values and groups of one robot."""

    def __init__(self, chain: SerialChain) -> None:
        self.chain, self.robot = chain, SymbolicRobot(chain)
        self.groups = parallel_groups(chain)
        inertial = DynamicParameters(chain)
        self.inertial = inertial.names
        self.lengths = kinematic_names(chain)
        down = [x for x in chain.gravity if x]
        single = len(down) == 1
        self.gravity = ["g_0"] if single else [f"g_{axis}" for axis, x in zip("xyz", chain.gravity, strict=True) if x]
        self.sign = Fraction(-1 if single and down[0] < 0 else 1)
        known = zip(inertial.names, inertial.values, strict=True)
        values = {name: float(value) for name, value in known if value is not None}
        values |= dict(zip(self.lengths, kinematic_values(chain), strict=True))
        values |= {name: float(self.sign * x) for name, x in zip(self.gravity, down, strict=True)}
        self.numbers = values

    def constants(self) -> list[list[Polynomial]]:
        """Replacement of each of the robot's constants: symbols, or numbers for rotations."""
        named = {".inertia": self.inertial, ".a_k": self.lengths, ".gravity": self.gravity}
        found = []
        for constant in self.robot.constants:
            names = next((names for ending, names in named.items() if constant.name.endswith(ending)), None)
            if names is None:
                found.append([Polynomial.number(value) for value in constant.values])
            elif names is self.gravity:
                found.append([Polynomial.number(self.sign) * Polynomial.symbol(name) for name in names])
            else:
                found.append([Polynomial.symbol(name) for name in names])
        return found

    def matrix(self, name: str, arguments: Sequence[tuple[str, Any]], expression: Any, drop: bool = False) -> Matrix:
        """A matrix of the robot as readable sums, in the named arguments after q."""
        q = ca.SX.sym("q", self.chain.n)
        symbols = [q, *(symbol for _, symbol in arguments), *(c.symbol for c in self.robot.constants)]
        function = ca.Function(name, symbols, [ca.densify(expression(q))])
        signals = [self._signal(label) for label, _ in arguments]
        (entries,) = expand(function, [self._angles(), *signals, *self.constants()])
        rows, columns = function.size_out(0)
        if drop:
            entries = [self._without_zeros(entry) for entry in entries]
        order = {label: k for k, label in enumerate(self._order([label for label, _ in arguments]))}
        terms = [terms_of(entry, self.groups, order) for entry in entries]
        table = tuple(tuple(terms[row + column * rows] for column in range(columns)) for row in range(rows))
        return Matrix(name, ", ".join(["q", *(label for label, _ in arguments)]), table)

    def _angles(self) -> list[tuple[int, tuple[int, ...]]]:
        return [
            (group, tuple(int(i == place) for i in range(len(signs))))
            for group, (_, signs) in enumerate(self.groups.members)
            for place in range(len(signs))
        ]

    def _signal(self, label: str) -> list[Polynomial]:
        return [Polynomial.symbol(f"{label}_{i}") for i in range(1, self.chain.n + 1)]

    def _order(self, signals: Sequence[str]) -> list[str]:
        moving = [f"{label}_{i}" for label in signals for i in range(1, self.chain.n + 1)]
        return [*self.lengths, *self.gravity, *self.inertial, *moving, *(f"q_{i}" for i in range(1, self.chain.n + 1))]

    def _without_zeros(self, entry: Polynomial) -> Polynomial:
        zero = {name for name in self.inertial if self.numbers[name] == 0}
        return Polynomial({key: value for key, value in entry.terms.items() if not zero & set(key.symbols)})

    def whole(self, friction: Collection[str], keep: Sequence[int] | None) -> WrittenOut:
        """Everything."""
        robot, n = self.robot, self.chain.n
        dq, dq_ref, ddq_ref, psi = (ca.SX.sym(name, n) for name in ("dq", "dq_ref", "ddq_ref", "psi"))
        motion = [("dq", dq), ("dq_ref", dq_ref), ("ddq_ref", ddq_ref)]
        Y_d = self.matrix("Y_d", motion, lambda q: robot.regressor(q, dq, dq_ref, ddq_ref))
        parameters = DynamicParameters(self.chain, friction)
        Y_d = _with_friction(Y_d, parameters)
        return WrittenOut(
            chain=self.chain,
            M=self.matrix("M", [], robot.mass_matrix, drop=True),
            C=self.matrix("C", [("dq", dq)], lambda q: robot.coriolis(q, dq), drop=True),
            g=self.matrix("g", [], robot.gravity_torque, drop=True),
            Y_d=_named_columns(Y_d, parameters.names, keep),
            Y_k=_named_columns(
                self.matrix("Y_k", [("psi", psi)], lambda q: robot.kinematic_regressor(q, psi)), self.lengths, None
            ),
            numbers=self.numbers,
            left_out=tuple(name for name in self.inertial if self.numbers[name] == 0),
        )


def parallel_groups(chain: SerialChain) -> Groups:
    """Neighbouring revolute joints whose axes are parallel at every pose, exactly."""
    members: list[tuple[int, list[int]]] = []
    for i, joint in enumerate(chain.joints):
        sign = _parallel(chain.joints[i - 1], joint) if i else 0
        if sign and joint.kind == "revolute":
            members[-1][1].append(members[-1][1][-1] * sign)
        else:
            members.append((i, [1]))
    return Groups(tuple((first, tuple(signs)) for first, signs in members), chain.n)


def _parallel(before: Any, joint: Any) -> int:
    """1 or -1 if the joint's axis is parallel or antiparallel to the previous one; 0 otherwise."""
    if before.kind != "revolute":
        return 0
    turned = tuple(sum((r * a for r, a in zip(row, joint.axis, strict=True)), Fraction(0)) for row in joint.rotation)
    if turned == before.axis:
        return 1
    return -1 if turned == tuple(-a for a in before.axis) else 0


def _with_friction(Y_d: Matrix, parameters: DynamicParameters) -> Matrix:
    """Y_d with the columns diag(dq_ref) and diag(phi(dq_ref)) of friction parameters, if any."""
    n, rows = parameters.chain.n, []
    for i, inertial in enumerate(Y_d.entries):
        parts: dict[Part, list[tuple[Term, ...]]] = {"inertial": [*inertial]}
        for part, label in _FRICTION.items():
            parts[part] = [(Term(Fraction(1), (f"{label}_{j + 1}",), ()),) if i == j else () for j in range(n)]
        rows.append(tuple(entry for part in parameters.in_order(parts) for entry in part))
    return Matrix(Y_d.name, Y_d.arguments, tuple(rows))


def _named_columns(matrix: Matrix, names: Sequence[str], keep: Sequence[int] | None) -> Matrix:
    """The kept columns that are not zero, with their names."""
    chosen = [c for c in (range(len(names)) if keep is None else keep) if any(row[c] for row in matrix.entries)]
    rows = tuple(tuple(row[c] for c in chosen) for row in matrix.entries)
    return Matrix(matrix.name, matrix.arguments, rows, tuple(names[c] for c in chosen))


def plain_text(matrix: Matrix) -> str:
    """Matrix as text, one entry per line without zeros."""
    style = Style(latex=False)
    lines = [f"{matrix.name}({matrix.arguments})"]
    lines += [f"  {label} = {style.sum(terms)}" for label, terms in _labelled(matrix, latex=False) if terms]
    return "\n".join(lines)


def _labelled(matrix: Matrix, *, latex: bool) -> list[tuple[str, tuple[Term, ...]]]:
    found = []
    for i, row in enumerate(matrix.entries, start=1):
        for j, terms in enumerate(row, start=1):
            if matrix.columns:
                column = latex_name(matrix.columns[j - 1]) if latex else matrix.columns[j - 1]
                label = rf"{matrix.name}[{i}, {column}]"
            elif len(row) == 1:
                label = f"{matrix.name}_{i}"
            else:
                label = f"{matrix.name}_{{{i}{j}}}" if latex else f"{matrix.name}_{i}{j}"
            found.append((label, terms))
    return found


def latex(written: WrittenOut) -> str:
    """The equations as a LaTeX fragment for any document that loads amsmath."""
    chain = written.chain
    parts = [
        f"% {_comment(chain.name)}: equations of motion, written by dmframe; needs amsmath.",
        r"% s_{12} = sin(q_1 + q_2), c_{12} = cos(q_1 + q_2), and so on; SI units.",
        "% Joints from the base: " + ", ".join(map(_comment, chain.joint_names)) + ".",
        "% m_i, mc_i and I_i: mass, first moments, and inertia about the origin of joint i's frame.",
        "% p_{y3}: the y component of joint 3's place in the frame of joint 2.",
    ]
    if written.left_out:
        parts.append("% Zero in the model, and left out of M, C and g: " + ", ".join(written.left_out) + ".")
    parts.append(
        r"\[ M(q)\,\ddot q_{\mathrm r} + C(q, \dot q)\,\dot q_{\mathrm r} + g(q) = "
        r"Y_d(q, \dot q, \dot q_{\mathrm r}, \ddot q_{\mathrm r})\, a_d, \qquad J(q)\,\psi = Y_k(q, \psi)\, a_k \]"
    )
    parts += [_align(matrix) for matrix in written.matrices]
    return "\n".join(parts) + "\n"


def _align(matrix: Matrix) -> str:
    style = Style(latex=True)
    rows = [f"  {label} &= {style.sum(terms, line=5)}" for label, terms in _labelled(matrix, latex=True)]
    if matrix.columns:
        rows = [row for row, (_, terms) in zip(rows, _labelled(matrix, latex=True), strict=True) if terms]
    return "\\begin{align*}\n" + " \\\\\n".join(rows) + "\n\\end{align*}"


def _comment(name: str) -> str:
    return name.replace("\n", " ")


def largest_difference(written: WrittenOut) -> float:
    """Largest difference of the printed M, C dq and g from Pinocchio, relative to the largest entry."""
    import pinocchio as pin

    from dmframe.robot.chain import pin_configuration

    chain = written.chain
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(5):
        q, dq = rng.uniform(-2, 2, (2, chain.n))
        numbers = written.numbers | {f"dq_{i + 1}": value for i, value in enumerate(dq)}
        M, C, g = (evaluate(matrix, numbers, q) for matrix in (written.M, written.C, written.g))
        data, configuration = chain.model.createData(), pin_configuration(chain, q)
        mass = pin.crba(chain.model, data, configuration)
        mass = np.triu(mass) + np.triu(mass, 1).T
        still = pin.computeGeneralizedGravity(chain.model, data, configuration).copy()
        moving = pin.nonLinearEffects(chain.model, data, configuration, dq) - still
        pairs = ((M, mass), (C @ dq, moving), (g.ravel(), still))
        size = max(float(np.max(np.abs(expected))) for _, expected in pairs)
        worst = max(worst, *(float(np.max(np.abs(found - expected))) / size for found, expected in pairs))
    return worst


def evaluate(matrix: Matrix, numbers: dict[str, float], q: np.ndarray) -> np.ndarray:
    """Numeric values of a printed matrix."""
    return np.array([[sum(term.at(numbers, q) for term in terms) for terms in row] for row in matrix.entries])
