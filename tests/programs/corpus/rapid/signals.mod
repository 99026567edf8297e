MODULE Signals
  VAR triggdata gunon;
  CONST robtarget p1:=<20|gripper|wobj0>;
  CONST robtarget p2:=<21|gripper|wobj0>;
  CONST robtarget p3:=<22|gripper|wobj0>;
  CONST robtarget p4:=<23|gripper|wobj0>;
  PROC glue()
    TriggIO gunon,10\DOp:=doGun,1;
    MoveJ p1,v1000,z10,gripper;
    TriggL p2,v200,gunon,z1,gripper;
    MoveLDO p3,v200,z1,gripper,doGun,0;
    MoveLSync p4,v200,fine,gripper,"afterwards";
  ENDPROC
  PROC afterwards()
    Reset doGun;
  ENDPROC
ENDMODULE
