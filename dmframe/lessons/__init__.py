"""Lessons of the course: reader, notebooks, and text for a terminal."""

from dmframe.lessons.lesson import Lesson, lessons
from dmframe.lessons.notebook import notebook
from dmframe.lessons.reading import readable

__all__ = ["Lesson", "lessons", "notebook", "readable"]
