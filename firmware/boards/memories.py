"""The memories of a board while nobody uses them: `flash` is loaded when somebody does."""


class SettingsMemory:
    """Has what `flash.Settings` has, which keeps nothing and is made anew for each use."""

    def __init__(self, folder, asleep):
        self._folder = folder
        self._asleep = asleep

    def __getattr__(self, name):
        from boards.flash import Settings

        return getattr(Settings(self._folder, self._asleep), name)


class ProgramMemory:
    """Makes a `flash.Program`, which see, with the beginning of one; forgets it with the end."""

    def __init__(self, folder, asleep):
        from boards.flash import Program

        self._folder = folder
        self._asleep = asleep
        self._program = None
        self.crc = Program(folder, asleep).crc

    def begin(self, size):
        """Make room for a program of so many bytes, or None."""
        if not self._asleep():
            raise OSError("a bridge is awake")
        if self._program is None:
            from boards.flash import Program

            self._program = Program(self._folder, self._asleep)
        self._program.begin(size)

    def write(self, data):
        """Take the next bytes."""
        self._begun().write(data)

    def end(self):
        """All bytes are there: let them take the place of the old program."""
        program = self._begun()
        program.end()
        self._settle(program)

    def cancel(self):
        """Drop what has not ended."""
        program = self._program
        if program is not None:
            program.cancel()
            self._settle(program)

    def _begun(self):
        if self._program is None:
            raise OSError("a program is written from its beginning on")
        return self._program

    def _settle(self, program):
        self.crc = program.crc
        self._program = None
