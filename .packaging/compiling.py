"""Compiles the inner loops of tracking at installation; without a C compiler nothing is lost but speed."""

from __future__ import annotations

import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCES = "gyrotrack/_native/*.c"


class Compiling(BuildHookInterface):
    """Puts the compiled module beside its source, into the wheel and into an editable installation alike."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Compile before the wheel is put together; its tag says for which machines it is."""
        if self.target_name != "wheel":
            return
        try:
            module = compiled(Path(self.root))
        except Exception as why:  # whatever a compiler or its absence brings forth
            self.app.display_warning(f"the inner loops are not compiled, tracking will be slower: {why}")
            return
        build_data["artifacts"].append(module)
        build_data["pure_python"] = False
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"cp311-abi3-{platform}"


def compiled(root: Path) -> str:
    """Compile, and return the module's path below the root."""
    from setuptools import Distribution, Extension

    extension = Extension(
        "gyrotrack._native._compiled",
        sorted(map(str, root.glob(SOURCES))),
        depends=sorted(map(str, root.glob("gyrotrack/_native/*.h"))),
        extra_compile_args=[] if sysconfig.get_platform().startswith("win") else ["-O3"],
        py_limited_api=True,
    )
    build = Distribution({"name": "gyrotrack", "ext_modules": [extension]}).get_command_obj("build_ext")
    with tempfile.TemporaryDirectory() as temporary:
        build.build_temp, build.build_lib, build.force = temporary, str(root), True
        build.ensure_finalized()
        build.run()
    return str(Path(build.get_ext_fullpath("gyrotrack._native._compiled")).relative_to(root).as_posix())
