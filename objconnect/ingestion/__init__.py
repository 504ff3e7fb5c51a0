"""Making scenes of folders of photographs."""
