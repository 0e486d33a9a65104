"""Forward simulation of what was fitted: controller, drive and a joint with set-valued friction."""
