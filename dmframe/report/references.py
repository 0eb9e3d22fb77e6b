"""The sources that the blocks of the library cite."""

from __future__ import annotations

from typing import Final

_REFERENCES: Final = {
    "WangTAC2020": "H. Wang, W. Ren, C. C. Cheah, Y. Xie, S. Lyu, “Dynamic Modularity Approach to Adaptive Control of "
    "Robotic Systems With Closed Architecture”, IEEE Transactions on Automatic Control 65(6), 2020, pp. 2760–2767.",
    "Flash1985": "T. Flash, N. Hogan, “The Coordination of Arm Movements: An Experimentally Confirmed Mathematical "
    "Model”, Journal of Neuroscience 5(7), 1985, pp. 1688–1703.",
    "SlotineLi1987": "J.-J. E. Slotine, W. Li, “On the Adaptive Control of Robot Manipulators”, International Journal "
    "of Robotics Research 6(3), 1987, pp. 49–59.",
    "SlotineLi1991": "J.-J. E. Slotine, W. Li, “Applied Nonlinear Control”, Prentice Hall, 1991.",
    "NarendraAnnaswamy1987": "K. S. Narendra, A. M. Annaswamy, “A New Adaptive Law for Robust Adaptation Without "
    "Persistent Excitation”, IEEE Transactions on Automatic Control 32(2), 1987, pp. 134–145.",
    "IoannouSun1996": "P. A. Ioannou, J. Sun, “Robust Adaptive Control”, Prentice Hall, 1996.",
    "LeeKwonPark2018": "T. Lee, J. Kwon, F. C. Park, “A Natural Adaptive Control Law for Robot Manipulators”, IEEE/RSJ "
    "International Conference on Intelligent Robots and Systems, 2018.",
    "Siciliano2009": "B. Siciliano, L. Sciavicco, L. Villani, G. Oriolo, “Robotics: Modelling, Planning and Control”, "
    "Springer, 2009.",
    "Spong2006": "M. W. Spong, S. Hutchinson, M. Vidyasagar, “Robot Modeling and Control”, Wiley, 2006.",
}


def reference(key: str) -> str:
    """The full title of a source; of one that a block of somebody else cites, where to look."""
    return _REFERENCES.get(key, "see the documentation of the block that cites it")
