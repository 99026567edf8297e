"""Stages: study and earlier results in, tables out. A module here that defines STAGE is a stage; the rest are helpers."""
