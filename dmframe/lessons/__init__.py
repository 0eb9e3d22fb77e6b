"""The lessons of the course: found, made into notebooks, and printed for a terminal."""

from dmframe.lessons.lesson import Lesson, lessons
from dmframe.lessons.notebook import notebook
from dmframe.lessons.reading import readable

__all__ = ["Lesson", "lessons", "notebook", "readable"]
