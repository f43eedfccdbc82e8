"""What tests and benchmarks examine, made with jaxroll: contours, fingertips, grasps."""
