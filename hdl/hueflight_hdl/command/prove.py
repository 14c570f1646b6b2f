"""hueflight-hdl prove"""

from __future__ import annotations

from importlib import import_module
from typing import Annotated

from cyclopts import Parameter

from ..boards.target import TargetError
from ..proofs.proof import Proof, ProofError
from ..proofs.proof import prove as prove_statement
from .app import EXIT_SHORT, Said, app, errors

DESIGNS = ("illuminator", "camera")


@app.command
def prove(
    design: str,
    /,
    *,
    only: Annotated[list[str] | None, Parameter(negative=())] = None,
    list_them: Annotated[bool, Parameter(name="--list", negative=())] = False,
) -> None:
    """Prove what is claimed of a design, for every input there can be.

    The exit code is 2 if a statement does not hold.

    Parameters
    ----------
    design
        illuminator or camera.
    only
        Names of proofs; by default all of them.
    list_them
        Only say what would be proved, and how.
    """
    proofs = {proof.name: proof for proof in _proofs(design)}
    names = only or list(proofs)
    if unknown := [name for name in names if name not in proofs]:
        raise TargetError(
            f"no proof {', '.join(unknown)} of the {design}: one of {', '.join(proofs)}"
        )
    said = Said()
    failed = 0
    for name in names:
        proof = proofs[name]
        if list_them:
            print(f"{name}: {proof.statement} ({proof.kind})")
            continue
        said(f"{name}, {proof.kind}")
        try:
            prove_statement(proof)
            print(f"proved: {proof.statement} ({proof.kind})")
        except ProofError as error:
            failed += 1
            errors.print(str(error))
    if failed:
        errors.print(f"{failed} of {len(names)} statements do not hold")
        raise SystemExit(EXIT_SHORT)


def _proofs(design: str) -> tuple[Proof, ...]:
    if design not in DESIGNS:
        raise TargetError(f"no design {design!r}: one of {', '.join(DESIGNS)}")
    return import_module(f"..proofs.{design}", __package__).PROOFS
