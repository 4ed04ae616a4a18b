"""Syntax trees of Python files, parsed when they are first asked for: not while tests are collected."""

import ast
import functools
import gc
from collections.abc import Mapping


@functools.cache
def parsed(file):
    """The syntax tree of a file; to look for garbage in one that grows takes most of the time."""
    gc.disable()
    try:
        return ast.parse(file.read_text(encoding="utf-8"))
    finally:
        gc.enable()


@functools.cache
def nodes(tree):
    """All nodes of a tree, which is walked once: most of what several tests do with it."""
    return tuple(ast.walk(tree))


class SourceTrees(Mapping):
    """Files and their syntax trees."""

    def __init__(self, files):
        self._files = dict.fromkeys(files)

    def __getitem__(self, file):
        if file not in self._files:
            raise KeyError(file)
        return parsed(file)

    def __iter__(self):
        return iter(self._files)

    def __len__(self):
        return len(self._files)
