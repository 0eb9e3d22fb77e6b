"""Scripts that exceed their budget on a robot: each ends by itself, with a fault that contains the reason."""

from __future__ import annotations

from typing import Final


def _looped(begin: str, body: str) -> str:
    return f"def attack():\n{begin}\n  while True:\n{body}\n  end\nend\n"


_SYNC = "    sync()"
_LIST = "".join(f"  x = {x}\n" for x in ("[1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", *["[x, x, x, x, x, x, x, x, x, x]"] * 2))
ATTACKS: Final[dict[str, tuple[str, str]]] = {
    "a list that doubles": (_looped("  x = [1]", "    x = [x, x]\n" + _SYNC), "of no more than"),
    "a list that doubles in place": (_looped("  x = [1, 1]", "    x[0] = x\n" + _SYNC), "no more than"),
    "lists by arguments": (
        "def attack():\n  def f(x):\n    return f([x, x])\n  end\n  f([1])\nend\n",
        "of no more than",
    ),
    "a large matrix": (
        _looped(
            "  y = [1, 2, 3, 4]\n  y = [y, y, y, y, y, y, y, y]\n  y = [y, y, y, y]\n  x = [0, 0, 0]\n  k = 0",
            "    x[k % 3] = [x[0], y]\n    k = k + 1\n" + _SYNC,
        ),
        "expected",
    ),
    "calls that hold lists": (
        "def attack():\n  def f(n):\n    local x = [0]\n    local k = 0\n    while k < 10:\n      x = [x, x]\n"
        "      k = k + 1\n      sleep(0.01)\n    end\n    f(n + 1)\n  end\n  f(0)\nend\n",
        "variables of no more than",
    ),
    "a text that doubles": (_looped('  x = "aaaaaaaa"', "    x = str_cat(x, x)\n" + _SYNC), "no more than"),
    "texts in lists": (
        _looped('  t = "a"\n  x = [t]', "    t = str_cat(t, t)\n    x = [x, t, t, t]\n" + _SYNC),
        "no more than",
    ),
    "a sum of 200 kB": ("x = " + "+".join(["1"] * 100_000) + "\n", "of no more than 20000 words"),
    "a sum that is not too long": ("def attack():\n  x = " + "+".join(["1"] * 9_000) + "\nend\n", "last line is done"),
    "20000 branches": (
        "def attack():\nx = 1\nif x:\n" + "elif x:\n" * 20_000 + "end\nend\n",
        "of no more than 20000 words",
    ),
    "2000 branches": (
        "def attack():\n  x = 1\n  if x == 0:\n" + "  elif x == 2:\n" * 2000 + "  end\nend\n",
        "no more than 500 branches",
    ),
    "parentheses": ("x = " + "(" * 5000 + "1" + ")" * 5000 + "\n", "nested too deeply"),
    "signs": ("x = " + "-" * 5000 + "1\n", "nested too deeply"),
    "comparisons": ("x = " + "<".join(["1"] * 5000) + "\n", "nested too deeply"),
    "elements of elements": ("def attack():\n  x = [1]\n  y = x" + "[0]" * 3000 + "\nend\n", "expected a list"),
    "either or else": ("x = " + " xor ".join(["True or False"] * 3000) + "\n", "nested too deeply"),
    "blocks": ("def attack():\n" + "if True:\n" * 3000 + "end\n" * 3001, "nested too deeply"),
    "functions in functions": (
        "def attack():\n" + "".join(f"def f{k}():\n" for k in range(2000)) + "end\n" * 2001,
        "nested too deeply",
    ),
    "a comment of every line": ("def attack():\n" + "#\n" * 90_000 + "end\n", "of no more than 20000 words"),
    "no wait": (_looped("  x = 1", "    x = -x"), "a loop without sync"),
    "no wait, by a long body": (_looped("  local x = 1", "    x\n" * 5000), "a loop without sync"),
    "work in each cycle": (
        _looped("  k = 0", "    k = 0\n    while k < 5000:\n      k = k + 1\n    end\n" + _SYNC),
        "in a second",
    ),
    "kinematics in each cycle": (
        _looped("  p = get_forward_kin([1, -1, 1, 0, 1, 0])", "    get_inverse_kin(p)\n" + _SYNC),
        "in a second",
    ),
    "kinematics of a motion": (
        _looped("  p = get_forward_kin([1, -1, 1, 0, 1, 0])", "    is_within_safety_limits(p)\n" + _SYNC),
        "in a second",
    ),
    "texts of a list": (_looped(_LIST, "    to_str(x)"), "a loop without sync"),
    "texts of a list by name": (_looped(_LIST, "    str_cat(op1=x, op2=x)"), "a loop without sync"),
    "messages of a list": (_looped(_LIST, "    textmsg(x)"), "a loop without sync"),
    "a list to a socket": (_looped(_LIST, "    socket_send_line(x)"), "a loop without sync"),
    "a norm of a list": (_looped(_LIST, "    norm(x[0])"), "a loop without sync"),
    "numbers of a text": (
        _looped('  t = "1"\n  k = 0\n  while k < 15:\n    t = str_cat(t, t)\n    k = k + 1\n  end', "    to_num(t)"),
        "a loop without sync",
    ),
    "speeds that are lists": ("speedj([[1], [1], [1], [1], [1], [1]])\n", "expected six numbers"),
    "angles that are texts": ('movej(["1", 1, 1, 1, 1, 1])\n', "expected six numbers"),
    "a pose of no numbers": (
        "def attack():\n  x = 1e400 - 1e400\n  movel(p[x, x, x, x, x, x])\nend\n",
        "no angles were found",
    ),
    "threads": (
        "def attack():\n  thread t():\n    sleep(9)\n  end\n  while True:\n    run t()\n  end\nend\n",
        "no more than 50 threads",
    ),
    "calls": ("def attack():\n  def f():\n    return f()\n  end\n  f()\nend\n", "nested too deeply"),
    "lists within lists": (_looped("  x = [1]", "    x = [x]\n" + _SYNC), "nested lists"),
    "an unknown host": ('socket_open("no.such.host.example", 1)\n', "expected an address"),
    "many numbers from a socket": ("socket_read_byte_list(1000000000)\n", "expected a count from 0 to 1000"),
    "an output of many bits": ("set_standard_digital_out(1000000000, True)\n", "expected a number from 0 to 7"),
    "an output of 70 bits": ("set_standard_digital_out(70, True)\n", "expected a number from 0 to 7"),
    "half a payload": ("set_payload(1, [0])\n", "expected a mass and three numbers"),
    "a name for each watchdog": ('rtde_set_watchdog("a name", 1)\n', "expected an input"),
    "a time without end": ("speedj([0, 0, 0, 0, 0, 0], 1, 1e400)\n", "OverflowError"),
    "a large integer": (_looped("  x = 2", "    x = x * x\n" + _SYNC), "an integer of 32 bits"),
}
"""By effect: the script, and a part of the message about it."""
