"""Every solution of six revolute joints by elimination: equations, determinant, roots, solutions, certificate."""
