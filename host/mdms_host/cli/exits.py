"""How the command ends: its exit codes, and which error leads to which of them."""

from enum import IntEnum


class Exit(IntEnum):
    """The exit codes."""

    OK = 0
    FAILURE = 1
    USAGE = 2
    TIME_LIMIT = 3
    NO_DEVICE = 4
    NODE_FAULT = 5


#: The exit code after Ctrl-C, as shells have it.
INTERRUPTED = 130

#: Exit codes by class of error; of a class and its bases, the nearest that is listed counts.
#: Classes are named here, not imported: a verb should not wait for the modules of the others.
EXITS = {
    "builtins.OSError": Exit.FAILURE,
    "mdms_array.run.FaultError": Exit.NODE_FAULT,
    "mdms_array.run.StoppedError": Exit.TIME_LIMIT,
    "mdms_array.run.TimeLimitError": Exit.TIME_LIMIT,
    "mdms_model.errors.Error": Exit.FAILURE,
    "mdms_model.errors.InputError": Exit.USAGE,
    "mdms_host.can_link.link.LinkError": Exit.NO_DEVICE,
    "mdms_host.commissioning.array_file.ArrayFileError": Exit.USAGE,
    "mdms_host.commissioning.commissioner.CommissionError": Exit.NODE_FAULT,
    "mdms_host.commissioning.doctor.emergency_stop.NobodyError": Exit.TIME_LIMIT,
    "mdms_host.commissioning.doctor.emergency_stop.OwnFaultError": Exit.NODE_FAULT,
    "mdms_host.commissioning.doctor.emergency_stop.StopTestError": Exit.FAILURE,
    "mdms_host.commissioning.lss_master.LssError": Exit.NODE_FAULT,
    "mdms_host.commissioning.network.CommissioningError": Exit.NODE_FAULT,
    "mdms_host.commissioning.network.SilentError": Exit.NO_DEVICE,
    "mdms_host.commissioning.node_ids.NodeIdError": Exit.FAILURE,
    "mdms_host.commissioning.cell_settings.ParameterError": Exit.USAGE,
    "mdms_host.coordination.other_host.OtherHostError": Exit.FAILURE,
    "mdms_sim.nodes.bank.MicropythonMissing": Exit.NO_DEVICE,
    "mdms_sim.nodes.bank.NodeError": Exit.NODE_FAULT,
    "mdms_model.fields.FieldError": Exit.USAGE,
    "mdms_model.fields.PolicyError": Exit.USAGE,
    "mdms_host.page.page.PageError": Exit.FAILURE,
    "mdms_model.run.folder.RunFolderError": Exit.USAGE,
    "mdms_model.scenario.scenario.ScenarioError": Exit.USAGE,
    "mdms_host.updating.bundles.BundleError": Exit.USAGE,
    "mdms_host.updating.bundles.KeyFileError": Exit.USAGE,
    "mdms_model.squeeze.SqueezeError": Exit.USAGE,
    "mdms_sim.plots.canvas.PictureFormatError": Exit.USAGE,
    "mdms_sim.plots.animation.EncoderMissingError": Exit.FAILURE,
    "mdms_sim.serve.endpoint.ServeError": Exit.FAILURE,
}


class CommandError(Exception):
    """Ends the command with one line on stderr and an exit code."""

    def __init__(self, message: str, code: Exit) -> None:
        super().__init__(message)
        self.code = code


def exit_of(error: Exception) -> Exit | None:
    """The exit code of an error; None for one that is a defect of the program."""
    if isinstance(error, CommandError):
        return error.code
    names = (f"{each.__module__}.{each.__qualname__}" for each in type(error).__mro__)
    return next((EXITS[name] for name in names if name in EXITS), None)


def text_of(error: Exception) -> str:
    """The error in one line: of a file, its name and what the system says of it."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)
