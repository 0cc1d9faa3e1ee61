"""The errors a user may see: one line that names what, the value, what was expected and what to do."""


class SoftrlError(Exception):
    """Base of every error whose message is meant for the user; the command exits with status 2."""


class ConfigError(SoftrlError):
    """A key, value or combination in the configuration is wrong."""


class ArtifactError(SoftrlError):
    """An artifact is missing, damaged, of another schema, or of another robot."""


class RecordingError(SoftrlError):
    """A recording or data file does not hold what its format promises."""


class MeshError(SoftrlError):
    """A mesh or surface cannot be used: filled cavity, inverted element, open surface."""


class SolverError(SoftrlError):
    """An iteration did not converge for too many samples, or diverged."""


class DriverError(SoftrlError):
    """The robot's driver lost the link, refused a command, or timed out."""
