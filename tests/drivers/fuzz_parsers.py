"""Coverage-guided fuzzing of both parsers, by `make fuzz`; needs atheris."""

import sys

import atheris

with atheris.instrument_imports(include=["drivers"]):
    from parser_oracle import Laser, Robot, take


def one_input(data):
    take(Robot(), data)
    take(Laser(), data)


atheris.Setup(sys.argv, one_input)
atheris.Fuzz()
