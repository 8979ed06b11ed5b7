"""The dialects that are written, by name."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from simbench.conventions import Meaning
from simbench.errors import InputError

Year: TypeAlias = Literal["2019", "2021", "2022", "2025"]

#: The year in which the dialect of each year began.
YEARS: dict[str, Year] = {
    "2019": "2019",
    "2020": "2019",
    "2021": "2021",
    "2022": "2022",
    "2023": "2022",
    "2024": "2022",
    "2025": "2025",
    "2026": "2025",
}
#: Extrinsics that are what their key says, in the frame of the velocities.
SELF_CONSISTENT: dict[Year, Meaning] = {
    "2019": Meaning("cam_T_imu"),
    "2021": Meaning("imu_T_cam"),
    "2022": Meaning("imu_T_cam"),
    "2025": Meaning("cam_T_imu"),
}
#: Extrinsics as in the files that were given out. Of 2025's, as those read them whose filters work.
AS_DISTRIBUTED: dict[Year, Meaning] = {
    "2019": Meaning("mixed"),
    "2021": Meaning("imu_T_cam", "frd"),
    "2022": Meaning("imu_T_cam", "frd"),
    "2025": Meaning("imu_T_cam", "flu", "regular"),
}
NAMES = (
    "a year from 2019 to 2026, alone (self-consistent extrinsics), with -as-distributed behind it, "
    "or with :READING as `simbench info` names it, such as 2022:imu_T_cam/frd"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """How a dataset is written.

    Attributes:
        year: the first in which files looked so: 2019 `cam_T_imu` and `rotational_velocity`, 2021
            no features, 2022 `.npz` with features, 2025 a pickled dict in an `.npy`.
        meaning: what its extrinsics are to hold.
    """

    year: Year
    meaning: Meaning

    @classmethod
    def named(cls, name: str) -> "Dialect":
        """The dialect of a name; see `NAMES`.

        Raises:
            InputError: there is none of this name.
        """
        year = YEARS.get(name[:4])
        table = {
            "": SELF_CONSISTENT,
            "-self-consistent": SELF_CONSISTENT,
            "-as-distributed": AS_DISTRIBUTED,
        }.get(name[4:])
        if year and table:
            return cls(year=year, meaning=table[year])
        if year and name[4] == ":":
            try:
                return cls(year=year, meaning=Meaning.named(name[5:]))
            except ValueError as error:
                raise InputError(f"{name}: {error}.") from error
        raise InputError(f"Expected a dialect: {NAMES}; got {name!r}.")

    @property
    def suffix(self) -> str:
        """That of its files."""
        return ".npy" if self.year == "2025" else ".npz"


#: What is written where nobody asks for another.
DEFAULT = Dialect(year="2022", meaning=SELF_CONSISTENT["2022"])
