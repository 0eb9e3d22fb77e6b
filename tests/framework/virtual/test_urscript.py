"""Scripts of clients: their results, and the messages of their faults."""

from __future__ import annotations

import math
from typing import Any

import pytest
from virtual_robots import robot, runs

from dmframe.virtual import ScriptError, VirtualRobot
from dmframe.virtual.words import ScriptBuffer

SHARED: list[VirtualRobot] = []


def held() -> VirtualRobot:
    """One robot, as these scripts do not move it."""
    if not SHARED:
        SHARED.append(robot())
    return SHARED[0]


def value(body: str) -> float:
    """The value that a program leaves in register 0."""
    script = f"def test():\n{body}\n  write_output_float_register(0, found)\nend\n"
    ended = runs(held(), script)
    assert "its last line is done" in ended.messages[-1], list(ended.messages)
    found: float = ended.registers.values["output_double_register_0"]
    return found


def fault(script: str) -> str:
    """The reason for the end of a program."""
    held().advance(60)  # the programs of the last tests share their first operations
    return runs(held(), script).messages[-1]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3 - 4 / 8", 6.5),
        ("-2 * -(3 + 1)", 8.0),
        ("7 % 4", 3.0),
        ("0x10 + 1e1 + .5", 26.5),
        ("norm([3, 4])", 5.0),
        ("pow(2, 10) + sqrt(16)", 1028.0),
        ("atan2(1, 1)", math.pi / 4),
        ("([1, 2] + [10, 20])[1]", 22.0),
        ("([1, 2] * 3)[0]", 3.0),
        ("get_list_length([1, 2, 3])", 3.0),
        ("p[1, 2, 3, 0, 0, 0][2]", 3.0),
        ("pose_trans(p[1, 0, 0, 0, 0, 1.5707963267948966], p[1, 0, 0, 0, 0, 0])[1]", 1.0),
        ("pose_inv(p[1, 2, 3, 0, 0, 0])[0]", -1.0),
        ('str_len(str_cat("ab", 12))', 4.0),
    ],
)
def test_expressions(expression: str, expected: float) -> None:
    assert value(f"  found = {expression}") == pytest.approx(expected)


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("1 < 2 and 2 < 3", True),
        ("not (1 == 1) or 2 >= 2", True),
        ("True xor True", False),
        ("1 != 1 or False and True", False),
        ("1 == 2 or\n    3 == 4 or\n    5 == 5", True),
    ],
)
def test_conditions_also_over_lines(condition: str, expected: bool) -> None:
    assert value(f"  found = 0\n  if {condition}:\n    found = 1\n  end") == expected


def test_functions_loops_and_branches() -> None:
    body = """
  def fibonacci(n, first=0, second=1):
    if n == 0:
      return first
    elif n < 0:
      return -1
    else:
      return fibonacci(n - 1, first=second, second=first + second)
    end
  end
  found = 0
  k = 0
  while True:
    k = k + 1
    if k == 3:
      continue
    end
    if k > 5:
      break
    end
    found = found + fibonacci(k)
  end
"""
    assert value(body) == 1 + 1 + 3 + 5


def test_what_a_function_assigns_is_its_own_unless_the_program_has_it() -> None:
    body = """
  global shared = 1
  outer = 10
  def change():
    shared = 2
    outer = 20
    mine = 5
    local found = 99
    return mine
  end
  found = 0
  change()
  found = found + shared + outer
"""
    assert value(body) == 22


def test_lists_are_values() -> None:
    assert value("  a = [1, 2]\n  b = a\n  b[0] = 5\n  found = a[0]") == 1


def test_a_client_may_put_a_number_before_the_next_statement() -> None:
    """As a user who finds a comment and writes after the end of its line."""
    assert value("  global offset = # here\n24    global other = # there\n3\n  found = offset + other") == 27


def test_threads_take_turns_once_a_cycle() -> None:
    body = """
  global turns = 0
  thread counts():
    while True:
      turns = turns + 1
      sync()
    end
  end
  one = run counts()
  two = run counts()
  sleep(0.02)
  kill one
  before = turns
  sleep(0.02)
  found = 100 * before + turns - before
  kill two
"""
    # ten cycles of 2 ms each: the threads begin in the first, and then run in every other
    assert value(body) == 100 * 20 + 10


def test_a_thread_can_be_waited_for() -> None:
    body = """
  global found = 0
  thread slow():
    sleep(0.1)
    found = 7
  end
  it = run slow()
  join it
"""
    assert value(body) == 7


@pytest.mark.parametrize(
    ("body", "line", "text"),
    [
        ("  x = 1 / 0", 2, "division by zero"),
        ("  sync()\n  y = x", 3, "x: expected a variable"),
        ("  x = [1, 2]\n  y = x[2]", 3, "expected an index from 0 to 1, found 2"),
        ("  if 1:\n  end", 2, "expected True or False"),
        ("  while True:\n  end", 2, "a loop without sync"),
        (
            "  def f(n):\n    if n > 0:\n      f(n - 1)\n      f(n - 1)\n    end\n  end\n  f(60)",
            2,
            "loop iterations, calls",
        ),
        ('  x = "a"\n  while True:\n    x = str_cat(x, x)\n  end', 4, "no more than 65536 characters"),
        ("  force_mode(1)", 2, "force_mode: the virtual robot does not emulate this function"),
        ("  x = [1] + [1, 2]", 2, "expected lists of equal length"),
        ('  x = "a" + 1', 2, "expected numbers"),
        ("  speedj([1, 2], 1)", 2, "expected six numbers"),
        ("  movej([0,0,0,0,0,0], v=-1)", 2, "movej: v: expected a positive number"),
        ("  write_output_integer_register(48, 1)", 2, "expected a number from 0 to 47, found 48"),
        ("  set_tcp(p[0, 0, 0.1, 0, 0, 0])", 2, "only tool is its flange"),
    ],
)
def test_a_fault_while_it_runs_ends_it_with_the_line(body: str, line: int, text: str) -> None:
    message = fault(f"def test():\n{body}\nend\n")
    assert f"test ends: line {line}: " in message
    assert text in message


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ("def test():\n  x = \nend\n", "line 3: expected a value, found end"),
        ("def test():\n  if True\n  end\nend\n", "line 2: expected ':', found the end of the line"),
        ("def test():\n  x = 1\n", "expected end, found the end of the script"),
        ("def test():\n  x = @\nend\n", "line 2: expected URScript, found '@'"),
        ("def test():\n  break\nend\n", "line 2: expected a loop around this statement, found break"),
        ("def test():\n  run other()\nend\n", "run other: expected a thread of this script"),
        ("def test():\n  1 = 2\nend\n", "line 2: expected a variable"),
        ("def test():\n  x = " + "(" * 5000 + "1" + ")" * 5000 + "\nend\n", "nested too deeply"),
    ],
)
def test_what_is_not_a_script_is_refused(script: str, text: str) -> None:
    with pytest.raises(ScriptError) as raised:
        held().load_script(script)
    assert text in str(raised.value)


@pytest.mark.parametrize(
    "body",
    [
        "  x = __builtins__",
        '  x = __import__("os")',
        '  x = open("/etc/hosts")',
        '  x = eval("1")',
        "  x = _g",
        "  x = _robot",
        "  table()",
        "  close()",
        "  self._robot = 1",
        "  x = [].append",
        "  x = lambda",
    ],
)
def test_a_script_reaches_nothing_of_python(body: str) -> None:
    try:
        message = fault(f"def test():\n{body}\nend\n")
    except ScriptError as refused:
        message = str(refused)
    assert any(word in message for word in ("expected", "does not emulate")), message


def test_text_arrives_in_pieces() -> None:
    whole = '# a comment\ndef a():\n  if True: # end\n    x = 1\n  end\n  textmsg("end")\nend\n'

    def taken(text: str) -> str:
        arriving = ScriptBuffer()
        arriving.text = text
        return arriving.take()

    assert taken(whole) == whole
    assert not any(taken(whole[:count]) for count in range(len("# a comment\n"), len(whole)))
    assert taken("stopj(2)\nrest") == "stopj(2)\n"
    assert taken("") == ""


def test_a_line_by_itself_is_a_program() -> None:
    ended: Any = runs(held(), "set_digital_out(3, True)\n")
    assert ended.digital_outputs == 8
    runs(held(), "set_digital_out(3, False)\n")


def test_calls_without_end_end_it() -> None:
    message = fault("def test():\n  def f():\n    return f()\n  end\n  f()\nend\n")
    assert message.endswith("calls of functions are nested too deeply")


def test_halt_ends_it() -> None:
    assert fault('def test():\n  halt\n  textmsg("not reached")\nend\n').endswith("test ends: halt")


@pytest.mark.parametrize("number", ["9" * 5000, "0x" + "f" * 5000, "1" + "0" * 10])
def test_an_integer_that_no_register_holds_is_a_fault_of_the_script(number: str) -> None:
    with pytest.raises(ScriptError, match="line 2: expected an integer of 32 bits, found one of"):
        held().load_script(f"def test():\n  x = {number}\nend\n")


def test_an_integer_that_grows_without_end_ends_the_script() -> None:
    message = fault("def test():\n  x = 3\n  while True:\n    x = x * x\n    sync()\n  end\nend\n")
    assert message.endswith("line 4: *: expected an integer of 32 bits, found a longer one")
    assert value("  found = 2147483647") == 2147483647


def test_a_speed_that_is_not_a_number_is_a_stop_without_a_warning() -> None:
    at = robot()
    at.load_script("def test():\n  speedj([1e300 * 1e300, 0, 0, 0, 0, 0], 1, 1)\nend\n")
    at.advance(2)
    assert at.safety.reason.startswith("protective stop: a target speed is not a number")
