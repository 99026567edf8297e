MODULE Track
  ! a track and a turn table of other makes: axes 7 and 8
  CONST robtarget pA:=<13|gripper|wobj0>;
  CONST robtarget pB:=<14|gripper|wobj0>;
  CONST jointtarget jA:=[[5,-5,5,0,45,0],[1250.5,-30,9E9,9E9,9E9,9E9]];
  PROC Shift()
    ActUnit STN1;
    MoveAbsJ jA,v500,fine,tool0;
    MoveJ pA,v500,fine,gripper;
    MoveL pB,v500,fine,gripper;
    DeactUnit STN1;
  ENDPROC
ENDMODULE
