"""From films of rotating bodies to their equations of motion.

Make a case from films::

    import gyrotrack

    casing = gyrotrack.extract("casing.mp4", "casing.h5", capture_fps=260)
    rotor = gyrotrack.extract("rotor_1.mp4", "rotor_1.h5", capture_fps=1000)
    case = gyrotrack.sync(casing, [rotor], "case1.h5", inertia_rotor=5.54e-5, inertia_casing=2.06e-5)
    gyrotrack.read("case1.h5")

The package `fitting` fits models to the case.

Public names, listed in ``__init__.pyi``, are imported on first use, so that ``import gyrotrack`` is fast.
"""

import lazy_loader

from gyrotrack._versions import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
