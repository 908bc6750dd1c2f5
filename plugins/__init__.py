"""Plugins for Mitsuba 3: import, choose a variant, call :func:`register`.

    import gva_mi_plugins  # before mitsuba: it chooses a libLLVM that works
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    gva_mi_plugins.register()
    integrator = mi.load_dict({"type": "mesh_normals"})

``mesh_normals/`` renders normals and silhouettes of meshes, ``gaussian_splat/`` the Gaussians of a
scene, which the scene's light may reach by the sensors ``behind_person`` and ``onto_surface``; each
package's docstring lists its files.

Importing this package loads no plugin. Mitsuba's types exist only after a variant is set, therefore
:func:`register` loads the plugin files.
"""

import importlib

from gva_mi.core import llvm

__all__ = ["register"]


def register() -> None:
    """Register the integrators ``mesh_normals`` and ``gaussian_splat``, and two sensors.

    Call it after ``mi.set_variant`` with a differentiable variant (``llvm_ad_rgb``), and again
    after a change to another one: Mitsuba keeps its plugins by variant. A second call is harmless.

    Raises:
        ImportError: this machine has no working libLLVM.
        RuntimeError: no variant is set, or one without derivatives.

    Example:
        >>> import gva_mi_plugins
        >>> import mitsuba as mi
        >>> mi.set_variant("llvm_ad_rgb")
        >>> gva_mi_plugins.register()
        >>> mi.load_dict({"type": "mesh_normals"}).aov_names()
        ['normal.X', 'normal.Y', 'normal.Z', 'mask']
    """
    llvm.require()
    import mitsuba as mi

    variant = mi.variant()
    if variant is None or "_ad_" not in variant:
        raise RuntimeError(
            "gva_mi_plugins.register(): needs a differentiable variant, and mi.variant() is "
            f'{variant}; call mi.set_variant("llvm_ad_rgb") first'
        )
    from gva_mi_plugins.gaussian_splat import integrator as gaussian_splat
    from gva_mi_plugins.gaussian_splat import lighting
    from gva_mi_plugins.mesh_normals import integrator as mesh_normals

    # Mitsuba makes its base classes anew for every variant, so the modules that derive from them
    # run again. All others look Mitsuba's types up when they are called.
    if not issubclass(mesh_normals.MeshNormals, mi.ad.integrators.common.ADIntegrator):
        for module in (lighting, gaussian_splat, mesh_normals):
            importlib.reload(module)
    mi.register_sensor("behind_person", lighting.BehindPerson)
    mi.register_sensor("onto_surface", lighting.OntoSurface)
    mi.register_integrator("gaussian_splat", gaussian_splat.GaussianSplat)
    mi.register_integrator("mesh_normals", mesh_normals.MeshNormals)
