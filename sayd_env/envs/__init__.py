"""The environments: sensors, reward, scenario draw and what a policy may know."""
