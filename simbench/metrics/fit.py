"""Whether the noise that a filter is told explains what it met, said in words."""

#: NIS/dof above is no chance, nor a method's own small inconsistency. Below less is said: what a
#: real drive is told allows for errors that last, and those leave single innovations small.
LARGE, SMALL = 2.0, 0.3
#: A gate that refuses this share, and ten times what it should, met what is not told.
REFUSED, TIMES = 0.02, 10.0


def noise_fit(
    nis_per_dof: float | None, rejected_share: float | None, gate: float | None
) -> str | None:
    """Say whether innovations are of the size, and refused as rarely, as the noise told implies.

    Args:
        nis_per_dof: of accepted sightings; 1 where all is as told.
        rejected_share: of the sightings that were tested.
        gate: probability that the gate passes a sighting as told.

    Returns:
        One or two sentences; None where nothing was tested.
    """
    if nis_per_dof is None or rejected_share is None:
        return None
    said = []
    if nis_per_dof > LARGE:
        said.append(
            f"Innovations are {nis_per_dof**0.5:.1f} times as large as the noise told explains "
            f"(NIS/dof {nis_per_dof:.2f}): tell more, --noise-pixel-px first."
        )
    if nis_per_dof < SMALL:
        said.append(
            f"Innovations have {nis_per_dof**0.5:.1f} times the size that the noise told implies "
            f"(NIS/dof {nis_per_dof:.2f}): the readings are better than told."
        )
    if rejected_share > max(REFUSED, TIMES * (1 - (gate or 1.0))):
        expected = "none" if gate is None else f"{100 * (1 - gate):.2g} %"
        said.append(
            f"{100 * rejected_share:.2g} % of the sightings were rejected, with noise as told it "
            f"would be {expected}: there are outliers, or the noise is larger than told."
        )
    return " ".join(said) or "The noise told fits the data."
