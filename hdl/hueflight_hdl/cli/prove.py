# SPDX-License-Identifier: Apache-2.0
"""The subcommand ``hueflight-hdl prove``."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated

from cyclopts import Parameter

from ..boards.target import TargetError
from ..proofs.proof import Proof, ProofError
from ..proofs.proof import prove as prove_statement
from .app import EXIT_SHORT, Progress, app, errors

DESIGNS = ("illuminator", "camera")


@app.command
def prove(
    design: str,
    /,
    *,
    only: Annotated[list[str] | None, Parameter(negative=())] = None,
    list_them: Annotated[bool, Parameter(name="--list", negative=())] = False,
) -> None:
    """Formally verify the stated properties of a design, for every possible input.

    The exit code is 2 if a property does not hold.

    Parameters
    ----------
    design
        Design to verify: illuminator or camera.
    only
        Name of a property to verify; may be repeated. The default is all properties.
    list_them
        List the properties and how each is verified, without verifying them.
    """
    proofs = {proof.name: proof for proof in _proofs(design)}
    names = only or list(proofs)
    if unknown := [name for name in names if name not in proofs]:
        raise TargetError(
            f"the {design} has no property {', '.join(unknown)}: choose from {', '.join(proofs)}"
        )
    progress = Progress()
    failed = 0
    for name in names:
        proof = proofs[name]
        if list_them:
            print(f"{name}: {proof.statement} ({proof.kind})")
            continue
        progress(f"{name}, {proof.kind}")
        try:
            prove_statement(proof)
            print(f"verified: {proof.statement} ({proof.kind})")
        except ProofError as error:
            failed += 1
            errors.print(str(error))
    if failed:
        errors.print(f"{failed} of {len(names)} properties do not hold")
        raise SystemExit(EXIT_SHORT)


def _proofs(design: str) -> tuple[Proof, ...]:
    if design not in DESIGNS:
        raise TargetError(f"there is no design {design!r}: choose one of {', '.join(DESIGNS)}")
    return import_module(f"..proofs.{design}", __package__).PROOFS
