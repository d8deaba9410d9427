"""Appearance and reward scaling of the control tasks."""

from envs.scenario import Appearance, LightCfg, PhysicsCfg, SurfaceMaterial

LOOKS = Appearance(
    materials={
        "ground": SurfaceMaterial(rgb=(0.62, 0.64, 0.66), roughness=0.9, specular=0.05),
        "wall": SurfaceMaterial(rgb=(0.75, 0.75, 0.72), roughness=0.9, specular=0.0),
    },
    lights=(LightCfg(kind="distant", direction=(-0.3, 0.4, -1.0), intensity=0.8, cast_shadow=True),),
)

CONTROL_60_HZ = PhysicsCfg(timestep_s=1.0 / 120.0, decimation=2)
"""Isaac Lab's classic tasks; every term of their rewards is weighted by the duration of a control step."""

STEP_S = CONTROL_60_HZ.timestep_s * CONTROL_60_HZ.decimation
